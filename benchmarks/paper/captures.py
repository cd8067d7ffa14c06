"""Captures of simulated rooms with the paper's rig, decoded once for all experiments."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_rooms import decoded

from calib.geometry import NO_FACE, Calibration, Intrinsics, Matches, Size
from calib.numerics import Floats
from calib.plane_segmentation import find_faces
from hw.settings import SimulatedRigSettings
from hw.simulated import Label, SimulatedRoom, place_room, true_calibration

PROJECTOR = Size(854, 480)
FULL, QUICK = Size(2448, 2048), Size(612, 512)


@dataclass(frozen=True)
class Setup:
    """Settings of an experiment. `scratch`: folder of decoded captures, shared by experiments."""

    rooms: tuple[int, ...]
    camera_size: Size
    projector_size: Size
    scratch: Path
    quick: bool = False


@dataclass(frozen=True)
class Captured:
    """`matches` with the faces found; `true_label` (N,): the true `Label` of each match's pixel."""

    matches: Matches
    true_label: np.ndarray
    truth: Calibration

    @property
    def with_true_faces(self) -> Matches:
        """The matches with their true faces, as from perfect masks."""
        on_face = self.true_label <= Label.FLOOR
        return self.matches.with_faces(np.where(on_face, self.true_label, NO_FACE).astype(np.int32))


def settings_of(room: int, pose: int = 0) -> SimulatedRigSettings:
    """The simulated rig's defaults: all light transport, gamma, noise and lens distortion are on; walls are square."""
    return SimulatedRigSettings(seed=room, pose=pose)


def captured(setup: Setup, room: int, pose: int = 0) -> Captured:
    """Render and decode a capture, or read it from an earlier run."""
    width, height = setup.camera_size
    path = setup.scratch / f"room-{room}-{pose}-{width}x{height}.npz"
    if not path.exists():
        setup.scratch.mkdir(parents=True, exist_ok=True)
        _keep(path, SimulatedRoom(settings_of(room, pose), setup.camera_size, setup.projector_size))
    truth = true_calibration(place_room(settings_of(room, pose), setup.camera_size, setup.projector_size))
    assert truth is not None  # its projector is a pinhole
    with np.load(path) as kept:
        matches = Matches(kept["camera_px"], kept["projector_px"], kept["face"], kept["sigma_px"])
        return Captured(matches, kept["true_label"], truth)


def _keep(path: Path, room: SimulatedRoom) -> None:
    projector, camera = room.room.projector.optics, room.room.camera.optics
    sizes = Size(camera.width, camera.height), Size(projector.width, projector.height)
    matches = find_faces(decoded(room, sizes[1]).matches, *sizes).matches
    x, y = np.rint(matches.camera_px).astype(int).T
    partial = path.with_suffix(".part.npz")
    np.savez(
        partial,
        camera_px=matches.camera_px.astype(np.float32),
        projector_px=matches.projector_px.astype(np.float32),
        sigma_px=np.asarray(matches.sigma_px, np.float32),
        face=matches.labels,
        true_label=room.ground_truth().label[y, x],
    )
    partial.replace(path)


def thinned(matches: Matches, count: int, seed: int) -> Matches:
    """A random sample of the faces' matches; all if there are no more."""
    on_face = np.flatnonzero(matches.labels != NO_FACE)
    if len(on_face) <= count:
        return matches[on_face]
    return matches[np.sort(np.random.default_rng(seed).choice(on_face, count, replace=False))]


def without_distortion(matches: Matches, truth: Calibration) -> Matches:
    """The matches of ideal lenses: the paper's 'corrected in advance'."""
    return replace(
        matches,
        camera_px=_straightened(matches.camera_px, truth.camera),
        projector_px=_straightened(matches.projector_px, truth.projector),
    )


def _straightened(pixels: Floats, device: Intrinsics) -> Floats:
    rays = device.unproject(np.asarray(pixels, np.float64))
    straight: Floats = rays[:, :2] * np.array(device.focal_px) + np.array(device.principal_point_px)
    return straight
