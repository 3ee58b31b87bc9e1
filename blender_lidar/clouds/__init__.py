"""Point clouds: one revolution over one frame, and cloud files in and out."""
