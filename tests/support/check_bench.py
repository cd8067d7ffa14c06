"""A small simulated rig whose light and lenses a test changes without building the room again."""

import copy
from dataclasses import replace

import numpy as np

from hw.rig import Rig
from hw.settings import SimulatedRigSettings
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.sensor import build_sensor
from hw.simulated.simulation import SimulatedRoom
from scanner.checking.report import CheckReport, CheckRow
from scanner.configuration.schema import Config, load_config

CAMERA, PROJECTOR = (306, 256), (214, 120)
PERIOD_US = 1e6 / 60
OVERRIDES = (
    "rig={backend: simulated, seed: 0}",
    f"camera={{width: {CAMERA[0]}, height: {CAMERA[1]}, principal_point: {{known: [157.04, 131.79]}}}}",
    f"projector={{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}",
    "corner.squareness_deg=0",
)


def config(*overrides: str) -> Config:
    return load_config(None, (*OVERRIDES, *overrides))


def changed(room: SimulatedRoom, **settings: object) -> SimulatedRoom:
    """The same room under other settings of its light, lenses and sensor."""
    other = copy.copy(room)
    other.settings = SimulatedRigSettings.model_validate(room.settings.model_dump() | settings)
    picture = replace(room.renderer.picture, gamma=other.settings.gamma, blur_px=other.settings.projector_blur_px)
    ambient = room.renderer.ambient * np.float32(other.settings.ambient / room.settings.ambient)
    other.renderer = replace(room.renderer, picture=picture, ambient=ambient)
    white = other.renderer.render(np.full(PROJECTOR[::-1], 255, np.uint8))
    other.sensor = build_sensor(other.settings, white)
    return other


def rig_in(room: SimulatedRoom) -> Rig:
    projector = SimulatedProjector(room)
    return Rig(projector, SimulatedCamera(room, projector), {"backend": "simulated"}, room.settings.refresh_hz)


def row(report: CheckReport, name: str) -> CheckRow:
    (found,) = [row for row in report.rows if row.name == name]
    return found
