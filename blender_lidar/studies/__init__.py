"""Studies that change one thing about a scene and score again: chart, stability; and compare, beside real sweeps."""
