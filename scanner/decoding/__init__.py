"""The parts of the decoder: what a sequence measures, folding frames in, fringe orders, masks, checks."""
