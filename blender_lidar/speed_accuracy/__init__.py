"""Speed charted against accuracy, and how much model a scene needs."""
