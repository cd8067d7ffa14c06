"""The rigs that `scan new` offers, each with its commented configuration."""

from dataclasses import dataclass


@dataclass(frozen=True)
class NewRig:
    """`example`: a file of configs/. What is found of the `backend`'s cameras, and of screens, is written into it."""

    about: str
    example: str
    backend: str | None = None


RIGS = {
    "simulated": NewRig("a simulated room corner; needs nothing", "room-sim.yaml"),
    "whole-room": NewRig("a simulated room, to scan with --stations", "room-whole-sim.yaml"),
    "aravis": NewRig("a GenICam camera (GigE or USB3 Vision) and a projector", "room.yaml", "aravis"),
    "opencv": NewRig("a webcam or a network camera, and a projector", "room-webcam.yaml", "opencv"),
    "gphoto2": NewRig("a tethered photo camera, and a projector", "room-photo-camera.yaml", "gphoto2"),
}
