"""Cameras and projectors, real and simulated: images in, images out."""
