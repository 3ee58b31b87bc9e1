"""One optimisation or evaluation: search, held-out verdict, score map, figures as hung, folder of results."""
