"""Simulated rooms without light between surfaces: the view of each station, by casting rays, in milliseconds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Matches, Pose
from calib.numerics import Floats, Image, Ints
from hw.settings import SimulatedRigSettings
from hw.simulated import DrawnRoom, ProjectorLight, Scene, Texture, paint, place_room, true_calibration

CAMERA = (612, 512)
PROJECTOR = (854, 480)
_SIDE = 3  # samples along a pixel of a picture
_PAINT_STREAM, _PICTURE_STREAM = 300, 301
_FULL_WELL = 20_000.0  # electrons


@dataclass(frozen=True)
class TrueStation:
    """Lengths in metres. `matches` have noise; `pixel` (N,): row · width + column of each; `surface` (N,): its surface
    of `scene`; `points` (N, 3): in the camera's frame. X_world = place.rotation X_camera + place.translation. `picture`
    (H, W): directly lit by the projector; None if not requested.
    """

    scene: Scene
    calibration: Calibration
    place: Pose
    matches: Matches
    pixel: Ints
    surface: Ints
    points: Floats
    picture: Image | None = None


def stations(
    number: int = 6,
    seed: int = 1,
    *,
    camera: tuple[int, int] = CAMERA,
    noise_px: float = 0.03,
    pictures: bool = False,
    **settings: object,
) -> list[TrueStation]:
    """All stations of one room, with matches at the centres of the camera's pixels."""
    found = []
    texture: Texture | None = None
    for pose in range(number):
        about = {"seed": seed, "room": "whole", "stations": number, "pose": pose, "walls_off_deg": 0.3, **settings}
        room = place_room(SimulatedRigSettings.model_validate(about), camera, PROJECTOR)
        seen = observed(room, np.random.default_rng([seed, pose]), noise_px)
        if pictures:
            texture = texture or paint(room.scene, np.random.default_rng([seed, _PAINT_STREAM]), None)
            seen = replace(
                seen, picture=lit_picture(room, texture, np.random.default_rng([seed, _PICTURE_STREAM, pose]))
            )
        found.append(seen)
    return found


def with_turned_projector(station: TrueStation, turn_deg: Sequence[float] | Floats) -> TrueStation:
    """The matches if its projector was rotated in the rig, by a rotation vector (3,) about its own axes; its
    `calibration` stays that of the other stations.
    """
    rig = station.calibration
    points = rig.pose @ station.points
    noise = station.matches.projector_px - rig.projector.project(points)
    turned = points @ Rotation.from_rotvec(turn_deg, degrees=True).as_matrix().T
    return replace(station, matches=replace(station.matches, projector_px=rig.projector.project(turned) + noise))


def observed(room: DrawnRoom, rng: np.random.Generator, noise_px: float) -> TrueStation:
    """What the rig in a room sees at the centres of the camera's pixels that its projector lights."""
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
        room.camera.pose,
        Matches(camera_px[:, pixel].T, seen + noise_px * rng.standard_normal(seen.shape), None, sigma_px),
        pixel,
        surface[pixel],
        (room.camera.rotation @ (points[:, pixel] - room.camera.centre[:, None])).T,
    )


def lit_picture(room: DrawnRoom, texture: Texture, rng: np.random.Generator) -> Image:
    """An 8-bit picture in the projector's light, with shot noise."""
    optics, light = room.camera.optics, ProjectorLight(room.scene, room.projector)
    x, y = (each.ravel() for each in np.meshgrid(np.arange(optics.width), np.arange(optics.height)))
    mean = np.zeros(len(x))
    steps = (np.arange(_SIDE) + 0.5) / _SIDE - 0.5
    for aside in steps:
        for down in steps:
            directions = room.camera.rays(np.stack([x + aside, y + down]))
            t, surface = room.scene.cast(room.camera.centre[:, None], directions)
            points = room.camera.centre[:, None] + t * directions
            uv = room.scene.surface_coordinates(surface, points)
            mean += texture.albedo(surface, uv) * light.direct(surface, points)[1] / _SIDE**2
    electrons = rng.poisson(np.clip(mean / np.percentile(mean, 99), 0.0, 1.0) * _FULL_WELL)
    grey = np.rint(255 * np.clip(electrons / _FULL_WELL, 0.0, 1.0)).astype(np.uint8)
    return grey.reshape(optics.height, optics.width)
