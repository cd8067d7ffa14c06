"""Brightness of frames and pixels: noise, flicker, response curve, exposure fusion, ghosting."""
