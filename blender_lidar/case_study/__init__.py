"""The case study of the paper, section V, made again: its Table II, Figs. 8 and 9, and how far to trust them."""
