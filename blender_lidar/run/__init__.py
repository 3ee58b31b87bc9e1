"""One optimisation or evaluation: search, held-out verdict, score map, tolerance, folder of results."""
