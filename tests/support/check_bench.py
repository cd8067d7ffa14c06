"""A small simulated rig whose light and lenses a test changes without solving the room again."""

from hw.rig import Rig
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.checking import CheckReport, CheckRow
from scanner.configuration import Config, load_config

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
    """The same room with other settings of its light, lenses and sensor."""
    return room.under(**settings)


def rig_in(room: SimulatedRoom) -> Rig:
    projector = SimulatedProjector(room)
    return Rig(projector, SimulatedCamera(room, projector), {"backend": "simulated"}, room.settings.refresh_hz)


def row(report: CheckReport, name: str) -> CheckRow:
    (found,) = [row for row in report.rows if row.name == name]
    return found
