"""A rigid scene before a rig at several stations, what pictures show of it, and the errors of these.

A rig that warms up shifts the projector's picture from station to station: these shifts are estimated as well where a
standard deviation of them is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from calib.geometry import PER_POSE, Matches, Pose
from calib.numerics import Bools, Floats, Ints
from calib.refinement import SHARED, Prior, State

CHOSEN_PX, ANYWHERE_PX = 1e-3, 1e4  # sigma of a place in a picture that was chosen, and of one that nothing tells
_PLACE_PX = 28.0  # pixels of the camera that the side of a place is: four windows of the alignment
_PER_SHIFT = 2  # columns of a projector picture's shift


@dataclass(frozen=True, eq=False)
class RigidScene:
    """What is estimated."""

    rig: State
    """Devices and their relative pose."""
    stations: tuple[Pose, ...]
    """Each one's motion X_station = R X_first + t."""
    points: Floats
    """(N, 3), in the first station's frame."""
    shift_px: Floats | None = None
    """(S, 2): by how much each station's projector picture is shifted, added to projected pixels; None if none is."""

    @cached_property
    def columns(self) -> "SceneColumns":
        """Those without points."""
        return SceneColumns(len(self.stations), self.shift_px is not None)

    @cached_property
    def places(self) -> Ints:
        """The cube (N,) of each point, of the size of some windows of pixels: errors of points in one are alike."""
        size = _PLACE_PX * float(np.median(self.points[:, 2])) / self.rig.camera[0]
        _, number = np.unique(np.floor(self.points / size).astype(np.int64), axis=0, return_inverse=True)
        return np.asarray(number.reshape(-1), np.int64)

    @property
    def size(self) -> int:
        """Columns without those of points: the rig's, and those of all stations."""
        return self.columns.size

    def of_stations(self, which: Sequence[int]) -> "RigidScene":
        """The scene of some of the stations, in the frame of the first of them."""
        if not which:
            return self
        first = self.stations[which[0]]
        back = first.inverse()
        shift_px = None if self.shift_px is None else self.shift_px[list(which)]
        return RigidScene(self.rig, tuple(self.stations[k] @ back for k in which), first @ self.points, shift_px)

    def with_station(self, pose: Pose) -> "RigidScene":
        """The scene with one more station, whose projector picture is not shifted."""
        shift_px = None if self.shift_px is None else np.append(self.shift_px, np.zeros((1, 2)), axis=0)
        return replace(self, stations=(*self.stations, pose), shift_px=shift_px)

    def with_shifts(self) -> "RigidScene":
        """The scene with columns for the shifts of projector pictures."""
        return self if self.shift_px is not None else replace(self, shift_px=np.zeros((len(self.stations), 2)))

    def moved(self, step: Floats, by_points: Floats) -> "RigidScene":
        """After a step (size,) and one of the points (N, 3)."""
        columns = self.columns
        stations = [
            pose.retract(step[columns.of_pose(number)], 1.0) for number, pose in enumerate(self.stations) if number
        ]
        shift_px = None if self.shift_px is None else self.shift_px + step[columns.of_shifts]
        return RigidScene(
            self.rig.moved(step[:SHARED]), (self.stations[0], *stations), self.points + by_points, shift_px
        )


@dataclass(frozen=True)
class SceneColumns:
    """Columns of a scene without points: the rig's 21, then each station's motion but the first's, and its shift."""

    stations: int
    """How many there are."""
    shifted: bool
    """Whether shifts are estimated."""

    @property
    def size(self) -> int:
        """Of all of them."""
        return SHARED + self._per_station * self.stations - PER_POSE

    @property
    def of_shifts(self) -> Ints:
        """(S, 2): those of all shifts; empty if none is estimated."""
        last = SHARED + self._per_station * (1 + np.arange(self.stations)) - PER_POSE
        return last[:, None] + np.arange(-_PER_SHIFT, 0) if self.shifted else np.zeros((0, _PER_SHIFT), np.int64)

    def of_pose(self, number: int) -> slice:
        """Those of a station's motion; `number` is not 0."""
        start = SHARED + self._per_station * number - PER_POSE
        return slice(start, start + PER_POSE)

    def of_station(self, number: int) -> tuple[slice, slice]:
        """All of a station's, and which of its own motion's and shift's they are: the first station does not move."""
        start, own = self.of_pose(number).start, slice(0 if number else PER_POSE, self._per_station)
        return slice(start + own.start, start + own.stop), own

    def free(self, prior: Prior) -> Ints:
        """Those (F,) that are estimated where a prior of the rig holds some."""
        return np.concatenate([np.flatnonzero(prior.free[:SHARED]), np.arange(SHARED, self.size)])

    @property
    def _per_station(self) -> int:
        return PER_POSE + (_PER_SHIFT if self.shifted else 0)


@dataclass(frozen=True, eq=False)
class SceneObservations:
    """Points of the scene in the pictures."""

    point: Ints
    """(M,): numbers of the points, ascending, each at least once."""
    station: Ints
    """(M,): numbers of the stations."""
    camera_px: Floats
    """(M, 2): where the point is in the camera's picture."""
    projector_px: Floats
    """(M, 2): where the projector lights what is at `camera_px`."""
    slope: Floats
    """(M, 2, 2): derivatives of the projector's pixel by the camera's, along the surface."""
    sigma_px: Floats
    """(M,): standard deviation of each coordinate of `projector_px`, for a given camera pixel."""
    keypoint_px: Floats
    """(M,): standard deviation of each coordinate of `camera_px`, before `ErrorScales.keypoint`. A point of a surface
    has `CHOSEN_PX` where it was chosen, and `ANYWHERE_PX` where only the surface is known to contain it."""

    def __getitem__(self, kept: Bools | Ints) -> "SceneObservations":
        return SceneObservations(*(getattr(self, field.name)[kept] for field in fields(self)))

    @property
    def is_located(self) -> Bools:
        """Those (M,) whose place in the camera's picture was found."""
        located: Bools = (self.keypoint_px > CHOSEN_PX) & (self.keypoint_px < ANYWHERE_PX)
        return located

    @property
    def is_chosen(self) -> Bools:
        """Those (M,) where a point of a surface was chosen."""
        chosen: Bools = self.keypoint_px <= CHOSEN_PX
        return chosen

    @classmethod
    def joined(cls, pieces: Sequence["SceneObservations"]) -> "SceneObservations":
        """All of some, ordered by point."""
        every = cls(*(np.concatenate([getattr(piece, field.name) for piece in pieces]) for field in fields(cls)))
        return every[np.argsort(every.point, kind="stable")]

    def sums(self, values: Floats) -> Floats:
        """Sums (N, ...) over the observations of each point of `values` (M, ...)."""
        starts = np.flatnonzero(np.diff(self.point, prepend=-1))
        return np.asarray(np.add.reduceat(values, starts, axis=0), np.float64)


NOTHING_OBSERVED = SceneObservations(
    np.zeros(0, np.int64),
    np.zeros(0, np.int64),
    np.zeros((0, 2)),
    np.zeros((0, 2)),
    np.zeros((0, 2, 2)),
    np.zeros(0),
    np.zeros(0),
)


@dataclass(frozen=True, eq=False)
class StationMatches:
    """Matches of which only one station is known to see the point: rays of both devices must meet."""

    matches: Matches
    """With sigmas."""
    station: Ints
    """(L,): numbers of the stations."""


@dataclass(frozen=True)
class ErrorScales:
    """Standard deviations of errors."""

    keypoint: float
    """A factor on those of keypoints."""
    lifted: float
    """A factor on those of keypoints' projector pixels."""
    matches: float
    """A factor on those of all matches."""
    drift_px: float = 0.0
    """Of the shift of a station's projector picture, in x and in y; 0: it stays where it is."""

    def times(self, factor: float) -> "ErrorScales":
        """All factors multiplied."""
        return ErrorScales(factor * self.keypoint, factor * self.lifted, factor * self.matches, self.drift_px)

    def grown(self, observed: Floats, matches: float) -> "ErrorScales":
        """Those of keypoints and of their projector pixels multiplied by `observed` (2,), that of all matches, which
        stays above a thousandth, by its own factor.
        """
        keypoint, lifted = observed
        return ErrorScales(
            float(self.keypoint * keypoint),
            float(self.lifted * lifted),
            max(self.matches * matches, 1e-3),
            self.drift_px,
        )
