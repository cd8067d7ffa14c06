"""The loopback rig: tests the code for real devices without hardware.

A virtual screen is the projector. A separate process serves a GigE Vision camera or a webcam, whose frames show a
simulated room lit by that screen. The scanner cannot tell it from real devices.
"""

from hw.loopback.camera import LitRoom
from hw.loopback.launcher import (
    CameraProcess,
    VirtualScreen,
    camera_process,
    loopback_network,
    loopback_rig,
    own_addresses,
    shown_on,
    virtual_screen,
)
from hw.loopback.settings import Conditions, LoopbackSettings, WebcamSettings
from hw.loopback.webcam import MjpegServer
