"""Measurement of camera or projector motion between fringe frames: its trajectory in time, its size and its effect on
the coordinates.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, Ints
from scanner.decoding.motion.device_motion import LEAST_PX, MotionEstimate, largest_bump_px
from scanner.decoding.motion.frame_equations import (
    UNKNOWNS,
    FringeModel,
    Projection,
    equations_of_motion,
    fringe_frames,
)
from scanner.decoding.motion.pixels import MotionPixels, ObservedFringes, choose_pixels
from scanner.decoding.motion.rigid_motion import COLUMNS, PER_DEVICE, CoordinateShift, RigidFit
from scanner.decoding.motion.single_frames import moved_one_by_one, shifts_of_frames
from scanner.decoding.sequence_plan import COSINE_PARAMETERS
from scanner.decoding.significance import AS_GOOD, FEW, NEARLY_ALL, OUTLYING_SIGMAS, REFITS

# Significance that interreflection and ripple do not reach at rest.
_SIGNIFICANT = 8.0
# Beyond this part of the shortest period, the motion is ambiguous.
_LINEAR_CYCLES = 1 / 6
_BOTH = np.eye(COLUMNS)  # devices


@dataclass(frozen=True)
class Trajectory:
    """The completed share of a motion over time, from 0 to 1.

    It is a step between the frames `first` and `last`, or a linear ramp from the one to the other if it is `slow`.
    """

    first: int
    last: int
    slow: bool = False

    def at(self, times: Ints) -> Floats:
        """Return the completed share (N,) of the motion in frames (N,)."""
        if self.slow:
            return (times - self.first) / (self.last - self.first)
        return (times >= self.last).astype(np.float64)


def trajectories_of(times: Ints) -> list[Trajectory]:
    """Return all that frames at these times (N,), in order, can tell apart: a slow drift, and bumps between two."""
    bumps = [Trajectory(int(first), int(last)) for first, last in pairwise(times)]
    return [Trajectory(int(times[0]), int(times[-1]), slow=True), *bumps]


@dataclass(frozen=True)
class MotionMeasurement:
    """The motion of one event, and what else may explain the fringes."""

    motion: MotionEstimate
    """Of the event."""
    contradicted: bool
    """Whether the fringes contradict rest, even if no single event explains it."""
    by_event: float
    """Share of what independent motion of all frames explains that the event explains."""


class MotionMeter:
    """Measures motion in the fringes of a capture; sizes are (width, height)."""

    def __init__(
        self,
        model: FringeModel,
        pixels: MotionPixels,
        sizes: tuple[tuple[int, int], tuple[int, int]],
        repeats: int,
    ) -> None:
        self._model, self._pixels, self._sizes, self._repeats = model, pixels, sizes, repeats
        self._equations = equations_of_motion(model, pixels)
        self._finest_period = min(fringe.period for fringe in model.frames.fringes)
        # The shifts of x of all pixels, then those of y.
        self._design = np.concatenate([*pixels.by_motion.transpose(1, 0, 2)])

    def measure(self) -> MotionMeasurement:
        """Return the motion that explains the fringes best, with the alternatives to it."""
        trajectories = trajectories_of(self._model.frames.times)
        gained = [self._along(trajectory, _BOTH).gained for trajectory in trajectories]
        likely = [
            trajectory for trajectory, of_it in zip(trajectories, gained, strict=True) if of_it >= AS_GOOD * max(gained)
        ]
        event = trajectories[int(np.argmax(gained))]
        fit, explained, devices, undecided = self._at_first_order(event), 0.0, _BOTH, False
        is_significant = fit.significance > _SIGNIFICANT and self._size_px(fit) > LEAST_PX
        if is_significant:
            devices, undecided = self._likelier_device(event)
            fit, explained = self._refined(event, devices)
        size_px = self._size_px(fit)
        linear = size_px < _LINEAR_CYCLES * self._finest_period
        first, last = min(trajectory.first for trajectory in likely), max(trajectory.last for trajectory in likely)
        contradicted = self._is_overdetermined and is_significant
        estimate = MotionEstimate(
            motion=fit.motion,
            # Aliasing, ripple and blurred frames differ between pixels: a motion explains few percent of them.
            significant=contradicted and explained > FEW and max(gained) > self._by_late_frame(),
            slow=event.slow,
            first=self._repeats * (event.first if event.slow else first),
            last=self._repeats * (event.last if event.slow else last),
            size_px=size_px,
            explained=explained,
            shift=self._disturbance(event, fit.motion),
            alternatives=tuple(
                self._disturbance(trajectory, devices @ self._along(trajectory, devices).values)
                for trajectory in likely
            ),
            largest_px=largest_bump_px(self._finest_period),
            linear=linear,
            undecided=is_significant and (undecided or not linear),
        )
        return MotionMeasurement(estimate, contradicted, self._by_event(max(gained)) if contradicted else 1.0)

    def _by_event(self, gained: float) -> float:
        """Return the share that an event explains of what independent pans and tilts of the camera explain."""
        count = len(self._model.frames.times)
        pan_and_tilt = self._unknowns[:, PER_DEVICE * count : (PER_DEVICE + 2) * count]
        return gained / max(self._equations.along(pan_and_tilt).gained, 1e-12)

    def _by_late_frame(self) -> float:
        """Return the decrease of χ² by the one frame that is best explained as a mixture with the frame before."""
        late = self._unknowns[:, COLUMNS * len(self._model.frames.times) :]
        return max(self._equations.along(direction[:, None]).gained for direction in late.T)

    @property
    def _unknowns(self) -> Floats:
        """Unit directions of all unknowns of the equations."""
        return np.eye(UNKNOWNS * len(self._model.frames.times))

    def _along(self, trajectory: Trajectory, devices: Floats) -> Projection:
        """Fit the motion of some `devices`, (8, 8) of both or (8, 4) of one, to first order."""
        share = trajectory.at(self._model.frames.times)[:, None]
        return self._equations.along(np.asarray(np.kron(np.eye(UNKNOWNS, COLUMNS) @ devices, share), np.float64))

    def _at_first_order(self, trajectory: Trajectory) -> RigidFit:
        projection = self._along(trajectory, _BOTH)
        return RigidFit(projection.values, self._equations.covariance(projection), projection.gained)

    def _likelier_device(self, trajectory: Trajectory) -> tuple[Floats, bool]:
        """Return the device whose motion explains more than that of the other if either alone explains about as much,
        as before a scene of little depth, and whether this is so. Return both devices otherwise.
        """
        devices = np.split(_BOTH, [PER_DEVICE], axis=1)
        gained = [self._along(trajectory, device).gained for device in devices]
        undecided = min(gained) > NEARLY_ALL * max(gained)
        return devices[int(np.argmax(gained))] if undecided else _BOTH, undecided

    @cached_property
    def _is_overdetermined(self) -> bool:
        """Whether every fringe has enough frames to reveal an outlier frame; with three, a nonlinear curve only shifts
        the phase.
        """
        return int(np.bincount(self._model.frames.of_fringe).min()) > COSINE_PARAMETERS

    def _size_px(self, fit: RigidFit) -> float:
        """Return the root mean square shift of the coordinates beyond its uncertainty."""
        variance = np.einsum("rc,rc->r", self._design @ fit.covariance, self._design)
        sure = np.maximum((self._design @ fit.motion) ** 2 - OUTLYING_SIGMAS**2 * variance, 0.0)
        return float(np.sqrt(2 * np.mean(sure)))

    def _disturbance(self, trajectory: Trajectory, motion: Floats) -> CoordinateShift:
        """Return the motion (8,) that x and y each contain, averaged over their fringes, without their common part.

        The common part is equivalent to another pose of the rig.
        """
        frames, share = self._model.frames, trajectory.at(self._model.frames.times)
        shares = np.array([self._share(share * (frames.of_fringe == fringe)) for fringe in frames.shortest])
        squares = np.array([np.mean(moved_px**2) for moved_px in np.split(self._design @ motion, 2)])
        common = float(shares @ squares / max(float(squares.sum()), 1e-12))
        return CoordinateShift(np.outer(shares - common, motion), *self._sizes)

    def _share(self, of_frames: Floats) -> float:
        """Return the share of the motion in a coordinate: that of the shortest fringe, which determines it
        (`fringes/systematic_error.py`), from the share (N,) that its frames have seen.
        """
        return float(np.mean(of_frames @ self._model.responses))

    def _refined(self, trajectory: Trajectory, devices: Floats) -> tuple[RigidFit, float]:
        """Refine a motion beyond first order (Gauss–Newton); also return how much of what is seen it explains."""
        at_first = self._along(trajectory, devices)
        values, share = at_first.values, trajectory.at(self._model.frames.times)[:, None]
        for _ in range(REFITS):
            moved_px = share * (self._pixels.by_motion @ devices @ values).T[self._model.frames.axis]
            equations = equations_of_motion(self._model.without(moved_px), self._pixels)
            more = equations.along(at_first.directions, known=values)
            values = values + more.values
        explained = self._equations.explained(at_first.of_frames, equations)
        return RigidFit(devices @ values, devices @ equations.covariance(more) @ devices.T, at_first.gained), explained


def measure_motion(fringes: ObservedFringes) -> MotionEstimate | None:
    """Return the motion during a capture; None if too few smooth pixels see fringes."""
    pixels, plan, tiles = choose_pixels(fringes), fringes.plan, fringes.tiles
    if pixels is None:
        return None
    frames, some = fringe_frames(plan), pixels.every_other
    model = FringeModel(frames, tiles.of_frames(frames.times.tolist(), some.number).astype(np.float64))
    measured = MotionMeter(model, some, (tiles.shape[::-1], fringes.projector_size), plan.repeats).measure()
    estimate = measured.motion
    if not measured.contradicted:
        return estimate
    shifts = shifts_of_frames(fringes, pixels, measured.by_event)
    if not shifts.is_no_event or not (estimate.significant or shifts.are_distinct_from_light):
        return estimate
    one_by_one = moved_one_by_one(estimate, plan, shifts, pixels)
    # Large shifts of single frames prove nothing: a bump by many px is not linear, so that no single event explains it
    # either.
    return estimate if estimate.is_too_large and one_by_one.is_too_large else one_by_one
