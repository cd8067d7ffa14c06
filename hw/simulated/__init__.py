"""A room, its light, and a camera and a projector in it.

Nothing here knows of patterns, decoding or calibration: the projector is shown a picture, the camera sees the room that
the picture lights. Vectors are stored component first, (3, n), in metres; the world's origin is the corner's vertex,
z is up, and the room lies where all coordinates are positive.
"""
