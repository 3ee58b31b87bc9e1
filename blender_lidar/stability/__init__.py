"""Where a scene's answer holds and where it breaks: one thing changed at a time, and a verdict on each."""
