"""Triangles: vehicle shapes, the frame they stand in, and what surface each triangle is. Needs numpy alone."""
