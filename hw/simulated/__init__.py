"""A simulated room, its light, and a camera and a projector in it.

Nothing here depends on patterns, decoding or calibration: the projector shows a picture, and the camera sees the room
that it lights. Vectors are stored component first, (3, n), in metres. The world's origin is the vertex of the corner, z
is up, and the room is where all coordinates are positive.
"""
