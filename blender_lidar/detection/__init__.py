"""Object detection: boxes from point clouds, and recall, precision and average precision of any detector."""
