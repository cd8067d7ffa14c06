"""Matches of a simulated thing at some steps, from rays with noise; no frames are rendered."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Matches, Pose, Size, rotation_about
from calib.numerics import Bools, Floats, Image, Ints
from calib.refinement import State, device_of
from hw.settings import SimulatedRigSettings, ThingSettings
from hw.simulated.things import SimulatedThing, Solid, TurntableScene, draw_solid
from scanner.capture import CaptureMetadata
from scanner.configuration import Config
from scanner.results import Decoded, GivenMatches

PROJECTOR = (854, 480)
NOISE_PX = 0.05
_BODIES = 24  # of a clutter


@dataclass(frozen=True, eq=False)
class ThingStation:
    """`place`: X_thing = R X_camera + t; `picture` (H, W): the scene under white light; `thing` (H, W): mask of the
    thing.
    """

    matches: Matches
    place: Pose
    calibration: Calibration
    picture: Image
    thing: Bools
    solid: Solid


def thing_stations(
    which: list[int], camera: tuple[int, int], seed: int = 0, noise_px: float = NOISE_PX, **thing: Any
) -> list[ThingStation]:
    """Stations at some steps of `rig.thing`'s settings."""
    rng = np.random.default_rng([seed, 17])
    found = []
    for step in which:
        settings = SimulatedRigSettings.model_validate({"seed": seed, "pose": step, "thing": {"kind": "lump", **thing}})
        found.append(_station(SimulatedThing(settings, camera, PROJECTOR), noise_px, rng))
    return found


def turned_stations(
    count: int, camera: tuple[int, int], seed: int = 0, noise_px: float = NOISE_PX, **thing: Any
) -> list[ThingStation]:
    """Stations of a thing alone, turned by 12 to 25° about random axes against the first."""
    return _turned(None, count, camera, seed, noise_px, **thing)


def turned_before_camera(
    seed: int, camera: tuple[int, int], axis: int, turn_deg: float, noise_px: float = NOISE_PX
) -> ThingStation:
    """A station like the first of `turned_stations`, with the thing turned about an axis of the camera."""
    settings = SimulatedRigSettings.model_validate({"seed": seed, "thing": {"kind": "lump", "background": False}})
    simulated = SimulatedThing(settings, camera, PROJECTOR)
    towards = simulated.room.camera.pose
    rotation = rotation_about(np.radians(turn_deg) * np.eye(3)[axis])
    turn = towards.rotation @ rotation @ towards.rotation.T
    simulated.pose = Pose(turn @ simulated.pose.rotation, simulated.pose.translation)
    simulated.stage = TurntableScene(simulated.solid, simulated.pose, settings.thing)
    return _station(simulated, noise_px, np.random.default_rng([seed, 20]))


def cluttered_stations(
    count: int, camera: tuple[int, int], seed: int = 0, noise_px: float = NOISE_PX, **thing: Any
) -> list[ThingStation]:
    """Places of a rig about a clutter of bodies that fills its picture, turned like `turned_stations`."""
    return _turned(_clutter(seed), count, camera, seed, noise_px, **thing)


def network_stations(
    cameras: int,
    projectors: int,
    count: int,
    camera: tuple[int, int],
    seed: int = 0,
    noise_px: float = NOISE_PX,
    *,
    is_cluttered: bool = False,
) -> list[dict[tuple[str, str], ThingStation]]:
    """Stations of a thing or a clutter before a network, by camera and projector; turned like `turned_stations`."""
    solid = _clutter(seed) if is_cluttered else None
    pairs = {
        (f"camera{c + 1}", f"projector{p + 1}"): _turned(
            solid, count, camera, seed, noise_px, [18, c, p], camera_place=c, projector_place=p
        )
        for c in range(cameras)
        for p in range(projectors)
    }
    return [{pair: stations[k] for pair, stations in pairs.items()} for k in range(count)]


def _turned(
    solid: Solid | None,
    count: int,
    camera: tuple[int, int],
    seed: int,
    noise_px: float,
    noise_stream: Sequence[int] = (),
    **thing: Any,
) -> list[ThingStation]:
    rng = np.random.default_rng([seed, 18])
    noise = np.random.default_rng([seed, *noise_stream]) if noise_stream else rng
    settings = SimulatedRigSettings.model_validate(
        {"seed": seed, "thing": {"kind": "lump", "background": False, **thing}}
    )
    found = []
    for number in range(count):
        simulated = SimulatedThing(settings, camera, PROJECTOR)
        simulated.solid = solid or simulated.solid
        if number:
            axis = rng.standard_normal(3)
            turn = rotation_about(axis * np.radians(rng.uniform(12, 25)) / np.linalg.norm(axis))
            simulated.pose = Pose(
                turn @ simulated.pose.rotation, simulated.pose.translation + 0.01 * rng.standard_normal(3)
            )
        simulated.stage = TurntableScene(simulated.solid, simulated.pose, settings.thing)
        found.append(_station(simulated, noise_px, noise))
    return found


def _clutter(seed: int) -> Solid:
    """Bodies of many sizes and kinds in a box as wide and high as one thing, with four times its depth."""
    rng = np.random.default_rng([seed, 19])
    vertices, triangles, albedo = list[Floats](), list[Ints](), list[Floats]()
    for _ in range(_BODIES):
        kind, size = rng.choice(["lump", "box", "vase"]), rng.uniform(0.02, 0.06)
        body = draw_solid(ThingSettings.model_validate({"kind": kind, "size_m": size}), rng)
        turn = Rotation.random(random_state=rng).as_matrix()
        centre = rng.uniform([-0.07, -0.05, -0.05], [0.07, 0.15, 0.05])
        triangles.append(body.triangles + sum(len(part) for part in vertices))
        vertices.append(body.vertices @ turn.T + centre)
        albedo.append(body.albedo)
    return Solid(np.concatenate(vertices), np.concatenate(triangles), np.concatenate(albedo))


def _station(simulated: SimulatedThing, noise_px: float, rng: np.random.Generator) -> ThingStation:
    pixels, bright, on_thing = simulated.seen()
    there = np.isfinite(pixels[..., 0])
    row, column = np.nonzero(there)
    noisy = pixels[there] + noise_px * rng.standard_normal((len(row), 2))
    matches = Matches(
        np.stack([column, row], axis=1).astype(np.float64), noisy, None, np.full(len(row), max(noise_px, 1e-3))
    )
    picture = _exposed(np.where(there, bright, 0.0), rng)
    return ThingStation(matches, simulated.truth.place, simulated.calibration, picture, on_thing, simulated.solid)


def true_rig(calibration: Calibration) -> State:
    """The state of a calibration of devices with square pixels."""
    return State(device_of(calibration.camera), device_of(calibration.projector), calibration.pose.in_baselines)


def _exposed(bright: Floats, rng: np.random.Generator) -> Image:
    level = 220 * bright / max(float(np.percentile(bright[bright > 0], 99)), 1e-12) + rng.standard_normal(bright.shape)
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def between(first: Pose, second: Pose) -> Pose:
    """X_first = R X_second + t, from two cameras' poses."""
    return first.inverse() @ second


def config_for(camera: tuple[int, int]) -> Config:
    """A configuration with the rig's sizes."""
    point = {"prior": "centre", "sigma_px": 18}
    return Config.model_validate(
        {
            "camera": {"width": camera[0], "height": camera[1], "principal_point": point},
            "projector": {"width": PROJECTOR[0], "height": PROJECTOR[1]},
        }
    )


def decoded(stations: list[ThingStation], camera: tuple[int, int], pictures: bool = False) -> list[Decoded]:
    """The stations as decoded captures."""
    metadata = CaptureMetadata(Size(*camera), Size(*PROJECTOR))
    return [
        Decoded(metadata, each.matches, GivenMatches(each.picture if pictures else None, 0.0), f"Station {number}")
        for number, each in enumerate(stations, start=1)
    ]
