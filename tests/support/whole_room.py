"""A simulated whole room without its light: what each station sees, by casting rays alone, in milliseconds."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Calibration, Matches, Motion
from calib.numerics import Floats, Ints
from hw.settings import SimulatedRigSettings
from hw.simulated.illumination import ProjectorLight
from hw.simulated.room import Room
from hw.simulated.scene import Scene
from hw.simulated.simulation import place_room
from hw.simulated.truth import true_calibration, true_place

CAMERA = (612, 512)
PROJECTOR = (854, 480)


@dataclass(frozen=True)
class TrueStation:
    """In metres. `matches` have noise; `pixel` (N,): row · width + column of each; `surface` (N,): the surface of
    `scene` that it is on; `points` (N, 3): where, in the camera's frame. X_world = place.rotation X_camera +
    place.translation.
    """

    scene: Scene
    calibration: Calibration
    place: Motion
    matches: Matches
    pixel: Ints
    surface: Ints
    points: Floats


def stations(
    number: int = 6, seed: int = 1, *, camera: tuple[int, int] = CAMERA, noise_px: float = 0.03, **settings: object
) -> list[TrueStation]:
    """All round one room, with matches at the centres of the camera's pixels."""
    found = []
    for pose in range(number):
        about = {"seed": seed, "room": "whole", "stations": number, "pose": pose, "walls_off_deg": 0.3, **settings}
        room = place_room(SimulatedRigSettings.model_validate(about), camera, PROJECTOR)
        found.append(_observed(room, np.random.default_rng([seed, pose]), noise_px))
    return found


def _observed(room: Room, rng: np.random.Generator, noise_px: float) -> TrueStation:
    optics = room.camera.optics
    x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    camera_px = np.stack([x.ravel(), y.ravel()]).astype(np.float64)
    directions = room.camera.rays(camera_px)
    t, surface = room.scene.cast(room.camera.centre[:, None], directions)
    points = room.camera.centre[:, None] + t * directions
    projector_px, irradiance = ProjectorLight(room.scene, room.projector).direct(surface, points)
    pixel = np.flatnonzero((irradiance > 0) & room.projector.optics.sees(projector_px))
    calibration = true_calibration(room)
    assert calibration is not None
    seen = projector_px[:, pixel].T
    sigma_px = np.full(len(seen), noise_px) if noise_px else None
    return TrueStation(
        room.scene,
        calibration,
        true_place(room),
        Matches(camera_px[:, pixel].T, seen + noise_px * rng.standard_normal(seen.shape), None, sigma_px),
        pixel,
        surface[pixel],
        (room.camera.rotation @ (points[:, pixel] - room.camera.centre[:, None])).T,
    )
