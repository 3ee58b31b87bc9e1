"""Scores of labelled point clouds: points and boxes in, a number for each vehicle out. Needs numpy alone."""
