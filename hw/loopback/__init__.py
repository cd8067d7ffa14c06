"""A rig without hardware, for the real path: a virtual screen is the projector, a process serves a GigE Vision
camera, or a webcam.

The camera's pictures are those of a simulated room, lit by what the virtual screen shows. The scanner under test knows
nothing of it: it opens its window on a screen and finds a camera in the network.
"""
