"""Brightness of frames and pixels: noise, flicker that is divided out, exposures that are merged."""
