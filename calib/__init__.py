"""Geometry of a camera and a projector that look at the corner of a room: arrays in, arrays out."""
