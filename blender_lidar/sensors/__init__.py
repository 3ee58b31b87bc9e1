"""What the LiDAR is and where it looks: beam tables, Eq. 1 directions, pose. Needs numpy alone."""
