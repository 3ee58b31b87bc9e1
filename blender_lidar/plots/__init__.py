"""Charts of a run, ready to print: plain arrays in, a PNG out. Matplotlib is imported only when a chart is drawn."""
