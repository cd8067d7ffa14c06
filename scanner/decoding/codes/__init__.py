"""Gray codes: the projector cell that each pixel is in."""
