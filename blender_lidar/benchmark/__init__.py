"""How long things take: ours by stage beside what others use, in one run, and how time and memory grow."""
