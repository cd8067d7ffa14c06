"""Starts of a calibration by the shapes of what stations saw, where their pictures have nothing in common.

All stations have one fundamental matrix, which leaves one parameter of the rig open where principal points are nearly
known: a camera's focal length determines the projector's. Along this line of trials a wrong focal length bends each
surface in its own way, so that they coincide only near the truth. Trials are judged by that, and the best are followed
by poses and rig together, each time with surfaces looked up anew (iterated closest points, Besl and McKay 1992; the
unknowns of the sensor among them, as in Huber and Hebert, "Fully automatic registration of multiple 3D data sets",
2003).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats
from calib.refinement import CAMERA, Knowledge, State, intrinsic_distance, without_lens
from calib.scene.adjustment import FEWEST_POINTS, FEWEST_STATIONS
from calib.scene.problem import SceneFit, SceneProblem
from calib.scene.rigid_scene import NOTHING_OBSERVED, ErrorScales, RigidScene, StationMatches
from calib.scene.start import fundamental_of, relative_pose
from calib.scene.surfaces import (
    Coincidence,
    LiftedSurface,
    Shape,
    coincidence,
    descended,
    descents,
    lifted_surface,
    registered,
    shapes_of,
)
from calib.scene.tracks import placed_stations
from calib.scene.views import MatchedView, some_matches

_FOCALS = np.geomspace(0.8, 3.2, 11)  # of the camera, in image widths
_RATIOS = 0.6, 1.0, 1.6  # of the projector's to the camera's, both in widths, from which lines find it
_LINES = 400  # matches
_AT_ONCE = 6  # stations by which trials are judged
_FOLLOWED = 3  # trials
_POINTS = 120  # of a surface
# Shares of the projector's width, by how much its pixels for a point and for the surface there may differ: at first,
# after each step that brings surfaces nearer, and for what is judged.
_NEARER, _NEAR = (0.035, 0.018, 0.009, 0.005, 0.005), 0.005
_STEPS, _LINE_STEPS, _CONVERGED = 8, 15, 1e-3  # of the adjustment between two looks, and to lines
_AS_STATED = ErrorScales(1.0, 1.0, 1.0)
_PER_MEDIAN = 1.5  # standard deviation of a coordinate by the median distance, with some room
# Another pose of a station is one that turns it by this, or moves its middle by some grains. It is as good if it brings
# about as much of the surface about as near.
_OTHER_DEG, _OTHER_GRAINS = 4.0, 2.0
_MOST_OTHERS = 6
_AS_MUCH, _AS_NEAR = 0.9, 2.0
_SAME_FOCAL = 0.03  # relative difference of focal lengths


@dataclass(frozen=True, eq=False)
class ShapeStart:
    """A rig and poses under which the surfaces of stations coincide, in baselines."""

    rig: State
    poses: Mapping[int, Pose]
    """Of the stations that belong together, by number, X_station = R X_first + t."""
    rivals: tuple[State, ...]
    """Other rigs under which surfaces coincide about as well."""
    sliding: tuple[int, ...]
    """Stations whose surfaces fit the others' in other poses about as well."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """A trial: a rig, and poses of some surfaces under it."""

    rig: State
    shapes: Sequence[Shape]
    poses: Sequence[Pose]
    """X_station = R X_first + t."""
    numbers: Sequence[int]
    """Of the surfaces."""

    def coincidence(self, within_px: float) -> Coincidence:
        """Of the surfaces."""
        return coincidence(self.rig, self.poses, self.shapes, _POINTS, within_px)

    def with_pose(self, number: int, pose: Pose) -> "_Placed":
        """With another pose of one surface."""
        return replace(self, poses=[*self.poses[:number], pose, *self.poses[number + 1 :]])


@dataclass(frozen=True, eq=False)
class _Surfaces:
    """What trials are made with."""

    surfaces: Sequence[LiftedSurface]
    matches: StationMatches
    """Of all stations, which must lie on their epipolar lines."""
    knowledge: Knowledge

    @property
    def near_px(self) -> float:
        """How far what coincides nearly may be apart in the projector's picture."""
        return _NEAR * self.knowledge.projector_size[0]

    def trials(self, fundamental: Floats) -> Iterator[State]:
        """Rigs on whose epipolar lines matches are, for each of the camera's focal lengths."""
        (width, _), (wide, _) = self.knowledge.camera_size, self.knowledge.projector_size
        centre = np.array(self.knowledge.projector_centre_px)
        for focal in _FOCALS:
            fits = []
            for ratio in _RATIOS:
                camera = without_lens(focal * width, np.array(self.knowledge.principal_point_px))
                projector = without_lens(ratio * focal * wide, centre)
                lit = self.matches.matches
                pose = relative_pose(fundamental, camera, projector, lit.camera_px, lit.projector_px)
                if pose is not None:
                    fits.append(self._on_lines(State(camera, projector, pose)))
            if fits:
                yield min(fits, key=lambda fit: fit.cost).scene.rig

    def _on_lines(self, rig: State) -> SceneFit:
        """The most likely rig by epipolar lines alone, with this focal length of the camera."""
        rig = self.knowledge.holding(rig)
        scene, prior = RigidScene(rig, (IDENTITY,), np.zeros((0, 3))), self.knowledge.prior(rig)
        prior = prior.holding(CAMERA.start)
        problem = SceneProblem(NOTHING_OBSERVED, self.matches, prior, _AS_STATED)
        return problem.adjust(scene, steps=_LINE_STEPS, converged=_CONVERGED)

    def placed(self, rig: State, count: int) -> _Placed | None:
        """The first `count` surfaces where they fit each other under a rig; None if too few do."""
        shapes = shapes_of(rig, self.surfaces[:count])
        poses = placed_stations(registered(rig, shapes), len(shapes))
        if len(poses) < FEWEST_STATIONS:
            return None
        return _Placed(rig, [shapes[k] for k in poses], [*poses.values()], [*poses])

    def followed(self, placed: _Placed) -> _Placed:
        """The trial after its poses and its rig followed what is near."""
        for share in _NEARER:
            within_px = share * self.knowledge.projector_size[0]
            met = placed.coincidence(within_px)
            if len(met.points) < FEWEST_POINTS:
                break
            lifted = _PER_MEDIAN * met.median_px(within_px) / float(np.median(met.observations.sigma_px))
            problem = SceneProblem(
                met.observations, self.matches, self.knowledge.prior(placed.rig), ErrorScales(1.0, lifted, 1.0)
            )
            scene = RigidScene(placed.rig, tuple(placed.poses), met.points)
            scene = problem.adjust(scene, steps=_STEPS, converged=_CONVERGED).scene
            shapes = shapes_of(scene.rig, [shape.surface for shape in placed.shapes])
            placed = _Placed(scene.rig, shapes, scene.stations, placed.numbers)
        return placed

    def slides(self, placed: _Placed, own: int) -> bool:
        """Whether one of the surfaces fits the others in another pose about as well."""
        here = placed.coincidence(self.near_px)
        partner = max(
            (k for k in range(len(placed.shapes)) if k != own), key=lambda k: here.count(self.near_px, own, k)
        )
        between = placed.poses[own] @ placed.poses[partner].inverse()
        for pose in _other_poses(placed.rig, placed.shapes[own], placed.shapes[partner], between):
            there = placed.with_pose(own, pose @ placed.poses[partner]).coincidence(self.near_px)
            if _is_as_good(there, here, self.near_px, own):
                return True
        return False


def start_by_shape(views: Sequence[MatchedView], knowledge: Knowledge) -> ShapeStart | None:
    """The rig under which the surfaces of three or more stations coincide best; None if there is none."""
    surface_views = [(k, surface) for k, view in enumerate(views) if (surface := lifted_surface(view)) is not None]
    fundamental = fundamental_of(views)
    if fundamental is None or len(surface_views) < FEWEST_STATIONS:
        return None
    matches = some_matches([view.matches for view in views], _LINES // len(views))
    surfaces = _Surfaces([surface for _, surface in surface_views], matches, knowledge)
    placed = [surfaces.placed(rig, _AT_ONCE) for rig in surfaces.trials(fundamental)]
    trials = [trial for trial in placed if trial is not None]
    cost_px = [trial.coincidence(surfaces.near_px).cost_px(surfaces.near_px) for trial in trials]
    solved: list[tuple[Coincidence, _Placed]] = []
    for k in np.argsort(cost_px)[:_FOLLOWED]:
        trial = surfaces.followed(trials[k])
        is_known = any(_have_same_focal(trial.rig, known.rig) for _, known in solved)
        solved.append((trial.coincidence(surfaces.near_px), trial))
        if is_known:
            break
    if not solved:
        return None
    met, best = min(solved, key=lambda solution: solution[0].cost_px(surfaces.near_px))
    rivals = [
        trial.rig
        for rival, trial in solved
        if _is_as_good(rival, met, surfaces.near_px) and not _have_same_focal(trial.rig, best.rig)
    ]
    if len(surface_views) > _AT_ONCE:
        every = surfaces.placed(best.rig, len(surface_views))
        best = best if every is None else surfaces.followed(every)
    sliding = [surface_views[k][0] for own, k in enumerate(best.numbers) if surfaces.slides(best, own)]
    poses = {surface_views[k][0]: pose for k, pose in zip(best.numbers, best.poses, strict=True)}
    return ShapeStart(best.rig, poses, tuple(rivals), tuple(sliding))


def _other_poses(rig: State, first: Shape, second: Shape, known: Pose) -> list[Pose]:
    """Other poses X_first = R X_second + t than a known one, at which the second fits the first well."""
    poses, _ = descended(rig, first, second, descents(rig, first, second)[0])
    middle = second.points.mean(axis=0)
    shift = np.linalg.norm(poses @ middle[None] - known @ middle, axis=2)[:, 0]
    is_other = (poses.angle_from(known) > np.radians(_OTHER_DEG)) | (shift > _OTHER_GRAINS * first.grain)
    return [poses[k] for k in np.flatnonzero(is_other)[:_MOST_OTHERS]]


def _is_as_good(candidate: Coincidence, reference: Coincidence, near_px: float, station: int | None = None) -> bool:
    """Whether one brings about as much of the surfaces, of a station or all, as near as another."""
    is_as_much = candidate.share_within(near_px, station) > _AS_MUCH * reference.share_within(near_px, station)
    noise_px = float(np.median(reference.observations.sigma_px)) if len(reference.points) else 0.0
    apart_px = max(reference.median_px(near_px, station), noise_px)  # descents end as near as that at best
    return is_as_much and candidate.median_px(near_px, station) < _AS_NEAR * apart_px


def _have_same_focal(rig: State, reference: State) -> bool:
    return bool(intrinsic_distance(rig, reference)[:2].max() < _SAME_FOCAL)
