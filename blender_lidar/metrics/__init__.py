"""Scores of labelled point clouds: points and boxes in, bits out. Needs numpy alone."""
