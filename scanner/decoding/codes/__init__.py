"""Gray codes: which cell of the projector a pixel is in."""
