"""Scores of mountings: one frame kept ready, many frames, processes, a cluster, fidelities."""
