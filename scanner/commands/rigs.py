"""What `scan new` offers: a row for each rig, with the configuration that explains itself."""

from dataclasses import dataclass


@dataclass(frozen=True)
class NewRig:
    """`example`: a file of configs/. Where there are `devices`, what is found of them is written into it."""

    about: str
    example: str
    devices: bool


RIGS = {
    "simulated": NewRig("a simulated room corner; needs nothing", "room-sim.yaml", devices=False),
    "whole-room": NewRig("a simulated room, to scan with --stations", "room-whole-sim.yaml", devices=False),
    "aravis": NewRig("a GenICam camera (GigE or USB3 Vision) and a projector", "room.yaml", devices=True),
}
