"""The loopback rig: tests the code for real devices without hardware.

A virtual screen is the projector. A separate process serves a GigE Vision camera or a webcam, whose frames show a
simulated room lit by that screen. The scanner cannot tell it from real devices.
"""
