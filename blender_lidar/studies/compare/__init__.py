"""Real, labelled sweeps beside what our shapes, beams and scores make of the same scenes."""
