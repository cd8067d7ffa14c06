"""Surfaces that stations measured, under any trial of the rig: their shapes, how they register, where they coincide.

What a station tells without a rig, projector pixels and their slopes on a coarse grid of its picture, is found once.
Each trial bends that into points and normals. They are registered pair by pair, by descents from small rotations in
all directions, and points of one are then looked up in the others' grids.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.geometry import radial_distortion as lens
from calib.numerics import Floats, Ints, at_random
from calib.refinement import State
from calib.registration import Gates, Patches, RangeImage, descend
from calib.scene.alignment import surface_at
from calib.scene.rigid_scene import ANYWHERE_PX, CHOSEN_PX, NOTHING_OBSERVED, SceneObservations
from calib.scene.views import Lifted, MatchedView, lift

_ACROSS = 150  # cells of the grid across a picture
_FEWEST_CELLS = 100
_OF_SIZE = 1 / 60  # the grain over the size of what is seen
_PATCHES, _FEW = 150, 60  # of a surface, that descend, and of the descents from all rotations
_SPACING_DEG, _MOST_DEG = 14.0, 40.0  # rotations from which descents start
_KEPT = 16  # of them
_WIDE, _CLOSE = np.array([8.0, 8.0, 6.0, 6.0, 4.0, 4.0]), np.array([3.0, 3.0, 2.0, 2.0, 1.5, 1.0, 1.0])  # grains
_CLOSER = np.array([1.0, 0.5, 0.3, 0.3, 0.3])
_BEHIND = 20.0  # grains, from a surface to its middle
_GATES = Gates(False, 3.0, float(np.cos(np.radians(50.0))), beyond=1.0, free=0.0, off=0.0, shows_backs=False)
_LIKE = 0.7  # cosine between normals of one surface


@dataclass(frozen=True, eq=False)
class LiftedSurface:
    """What a station measured, on a grid of its picture, whatever the rig is."""

    camera_px: Floats
    """(K, 2): centres of the cells where there is a surface."""
    lifted: Lifted
    """The projector's pixels there."""
    number: Ints
    """(h, w): which of them a cell of the grid has; -1 for none."""
    step: int
    """Pixels of the picture from one cell to the next."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A station's surface under a rig, in baselines."""

    surface: LiftedSurface
    points: Floats
    """(K, 3), in the camera's frame."""
    normals: Floats
    """(K, 3), towards the camera."""

    def image(self, camera: Floats) -> RangeImage:
        """What a camera (8,) measured, on the grid. What is not known to be behind a point counts as free."""
        step, points, normals = self.surface.step, self._on_grid(self.points), self._on_grid(self.normals)
        known = np.where(np.isfinite(points[..., 2]), points[..., 2], np.float32(np.inf))
        near = np.asarray(cv2.erode(known, np.ones((3, 3), np.uint8)), np.float32)
        focal, (x, y) = camera[0] / step, (camera[1:3] - step // 2) / step
        return RangeImage(points, normals, near, near, np.array([focal, focal, x, y, *camera[3:]]))

    def _on_grid(self, values: Floats) -> NDArray[np.float32]:
        """Values (K, 3) on the grid, (h, w, 3); NaN where there is no surface."""
        number = self.surface.number
        return np.where((number >= 0)[..., None], values[number], np.nan).astype(np.float32)

    def patches(self, count: int) -> Patches:
        """Some of the cells."""
        some = at_random(len(self.points), count)
        return Patches(self.points[some], self.normals[some])

    @cached_property
    def grain(self) -> float:
        """A sixtieth of the surface's size."""
        return _OF_SIZE * float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def centre(self) -> Floats:
        """Where the normals converge, (3,)."""
        return self.patches(_PATCHES).normal_centre(_BEHIND * self.grain)


def lifted_surface(view: MatchedView) -> LiftedSurface | None:
    """The surface of a view; None if there is hardly any."""
    height, width = view.places.shape[:2]
    step = max(1, width // _ACROSS)
    column, row = np.meshgrid(np.arange(step // 2, width, step), np.arange(step // 2, height, step))
    measured = np.isfinite(view.places[row, column, 0])
    pixels = np.stack([column[measured], row[measured]], axis=1).astype(np.float64)
    lifted = lift(view.places, pixels)
    kept = lifted.is_smooth
    if np.count_nonzero(kept) < _FEWEST_CELLS:
        return None
    number = np.full(measured.shape, -1)
    number[measured] = np.where(kept, np.cumsum(kept) - 1, -1)
    return LiftedSurface(pixels[kept], lifted[kept], number, step)


def shapes_of(rig: State, surfaces: Sequence[LiftedSurface]) -> list[Shape]:
    """The surfaces under a rig."""
    shapes = []
    for surface in surfaces:
        points, tangents = surface_at(rig, surface.camera_px, surface.lifted.projector_px, surface.lifted.slope)
        normals = np.cross(tangents[..., 0], tangents[..., 1])
        normals /= -np.linalg.norm(normals, axis=1, keepdims=True) * np.sign(np.sum(normals * points, axis=1))[:, None]
        shapes.append(Shape(surface, points, normals))
    return shapes


@cache
def _starting_turns() -> Floats:
    """Rotations (K, 3, 3) about all axes, by no more than what stations have in common surfaces after."""
    steps = _SPACING_DEG * np.arange(-(_MOST_DEG // _SPACING_DEG), _MOST_DEG // _SPACING_DEG + 1)
    vectors = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    near = vectors[np.linalg.norm(vectors, axis=1) <= _MOST_DEG]
    return np.asarray(scipy.spatial.transform.Rotation.from_rotvec(near, degrees=True).as_matrix(), np.float64)


def descents(rig: State, first: Shape, second: Shape) -> tuple[Pose, Floats]:
    """Poses (K,), X_first = R X_second + t, of the best descents, and their worth in patches (K,); best first."""
    turns = _starting_turns()
    starts = Pose(turns, first.centre - turns @ second.centre)
    wide, _ = descended(rig, first, second, starts, _WIDE, _FEW)
    return descended(rig, first, second, wide[:_KEPT], _CLOSE)


def descended(
    rig: State, first: Shape, second: Shape, poses: Pose, grains: Floats = _CLOSER, count: int = _PATCHES
) -> tuple[Pose, Floats]:
    """Poses (K,), X_first = R X_second + t, after descents by `count` patches, and their worth in patches (K,); best
    first. `grains`: how near patches are that match, at each step.
    """
    image, patches = first.image(rig.camera), second.patches(count)
    moved, worth = descend(image, patches, poses, _GATES, first.grain * grains, first.centre)
    order = np.argsort(-worth)
    return moved[order], worth[order]


def registered(rig: State, shapes: Sequence[Shape]) -> dict[tuple[int, int], tuple[Pose, float]]:
    """By pairs of shapes: X_first = R X_second + t, and its worth in patches."""
    registrations = {}
    for i, j in combinations(range(len(shapes)), 2):
        poses, worth = descents(rig, shapes[i], shapes[j])
        if worth[0] > 0:
            registrations[i, j] = poses[0], float(worth[0])
    return registrations


@dataclass(frozen=True, eq=False)
class Coincidence:
    """Where points of stations' surfaces are on those of others, under a rig and poses."""

    observations: SceneObservations
    points: Floats
    """(N, 3): of the observations, in the first station's frame."""
    apart_px: Mapping[tuple[int, int], Floats]
    """By pairs of a station and another that should see its points: how far the projector's pixels (M,) that the points
    should be lit by are from those that light the other's surface there; infinite where that has none, or turned
    otherwise."""

    def share_within(self, limit_px: float, station: int | None = None) -> float:
        """The share of points, of one station or in it, whose projector pixels are that near."""
        apart = self._of(station)
        return float(np.mean(apart < limit_px)) if len(apart) else 0.0

    def median_px(self, limit_px: float, station: int | None = None) -> float:
        """The median of those that are within a limit; infinite if none is."""
        apart = self._of(station)
        within = apart[apart < limit_px]
        return float(np.median(within)) if len(within) else np.inf

    def count(self, limit_px: float, first: int, second: int) -> int:
        """Points of two stations that are that near to the other's surface."""
        return sum(int(np.count_nonzero(self.apart_px[pair] < limit_px)) for pair in ((first, second), (second, first)))

    def cost_px(self, limit_px: float) -> float:
        """The mean distance, none counted as more than a limit."""
        apart = self._of(None)
        return float(np.mean(np.minimum(apart, limit_px))) if len(apart) else limit_px

    def _of(self, station: int | None) -> Floats:
        chosen = [apart for pair, apart in self.apart_px.items() if station is None or station in pair]
        return np.concatenate([np.zeros(0), *chosen])


def coincidence(
    rig: State, poses: Sequence[Pose], shapes: Sequence[Shape], count: int, within_px: float
) -> Coincidence:
    """What `count` points of each station say of poses X_station = R X_first + t.

    Observations are of points that are nearer than `within_px` to another's surface in the projector's picture.
    """
    pieces, points, apart_px = [NOTHING_OBSERVED], [np.zeros((0, 3))], {}
    for i, shape in enumerate(shapes):
        some, back = at_random(len(shape.points), count), poses[i].inverse()
        by_target = []
        for j, target in enumerate(shapes):
            if j != i:
                apart_px[i, j], observations = _looked_up(rig, poses[j] @ back, shape, some, target, within_px)
                by_target.append(replace(observations, station=np.full(len(observations.point), j)))
        target_observations = SceneObservations.joined(by_target)
        chosen, point = np.unique(target_observations.point, return_inverse=True)
        own = _observed(shape.surface, chosen, shape.surface.camera_px[chosen], chosen, CHOSEN_PX)
        first = sum(map(len, points))
        pieces += [
            replace(own, point=first + np.arange(len(chosen)), station=np.full(len(chosen), i)),
            replace(target_observations, point=first + point),
        ]
        points.append(back @ shape.points[chosen])
    return Coincidence(SceneObservations.joined(pieces), np.concatenate(points), apart_px)


def _looked_up(
    rig: State, motion: Pose, shape: Shape, some: Ints, target: Shape, within_px: float
) -> tuple[Floats, SceneObservations]:
    """`some` cells (N,) of a shape that another should see after a motion X_other = R X_shape + t: how far their
    projector pixels are from those there (M,), and observations of those that are near, numbered by their cells.
    """
    places, normals = motion @ shape.points[some], motion.rotate(shape.normals[some])
    towards = (places[:, 2] > 0) & (np.sum(places * normals, axis=1) < 0)
    some, places, normals = some[towards], places[towards], normals[towards]
    pixels, _, _ = lens.project(rig.camera, places)
    lit_px, _, _ = lens.project(rig.projector, rig.pose @ places)
    height, width = target.surface.number.shape
    step = target.surface.step
    column, row = np.floor((pixels - step // 2) / step + 0.5).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    number = np.where(inside, target.surface.number[row * inside, column * inside], -1)
    expected_px = _projector_px(target.surface, number, pixels)
    is_same = (number >= 0) & (np.sum(normals * target.normals[number], axis=1) > _LIKE)
    apart = np.where(is_same, np.linalg.norm(lit_px - expected_px, axis=1), np.inf)
    near = apart < within_px
    return apart[inside], _observed(target.surface, some[near], pixels[near], number[near], ANYWHERE_PX)


def _observed(
    surface: LiftedSurface, point: Ints, camera_px: Floats, number: Ints, sigma_px: float
) -> SceneObservations:
    """Points of a surface at camera pixels (M, 2) near the cells `number` (M,)."""
    count, lifted = len(point), surface.lifted[number]
    return SceneObservations(
        point,
        np.zeros(count, np.int64),
        camera_px,
        _projector_px(surface, number, camera_px),
        lifted.slope,
        lifted.sigma_px,
        np.full(count, sigma_px),
    )


def _projector_px(surface: LiftedSurface, number: Ints, camera_px: Floats) -> Floats:
    """The projector's pixels (M, 2) at camera pixels (M, 2) near cells `number` (M,)."""
    lifted = surface.lifted[number]
    step = camera_px - surface.camera_px[number]
    return np.asarray(lifted.projector_px + (lifted.slope @ step[..., None])[..., 0], np.float64)
