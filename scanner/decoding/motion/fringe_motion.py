"""Measurement of camera or projector motion between fringe frames: its trajectory in time, its size and its effect on
the coordinates.

It is one event, a bump or an even drift, or small motion of every frame, as of hand-held cameras and software image
stabilisation. Least squares over thousands of pixels measures the shift of each frame (`frame_equations`) from the
slopes of the frames themselves: to first order, a shift by d changes a frame I by −∇I · d, that of the fringes and that
of the texture. A shift that all frames share is unobservable.
"""

from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise
from math import sqrt

import numpy as np
import scipy

from calib.numerics import LEVEL, SLOPE, Floats, Floats32, Ints
from scanner.decoding.light import TILE_PX, NoiseModel, TileSample
from scanner.decoding.motion.frame_equations import (
    UNKNOWNS,
    FrameEquations,
    FringeFrames,
    FringeModel,
    Projection,
    equations_of_motion,
    fringe_frames,
    of_frames,
)
from scanner.decoding.motion.fringe_pixels import MotionPixels, ObservedFringes, choose_pixels
from scanner.decoding.motion.motion_estimate import (
    LEAST_PX,
    MotionCourse,
    MotionEstimate,
    MotionVerdict,
    largest_bump_px,
)
from scanner.decoding.motion.rigid_motion import COLUMNS, PER_DEVICE, CoordinateShift, RigidFit
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, Fringe, SequencePlan
from scanner.decoding.significance import AS_GOOD, BY_CHANCE, FEW, HALF, NEARLY_ALL, OUTLYING_SIGMAS, REFITS

# Significance that interreflection and ripple do not reach at rest.
_SIGNIFICANT = 8.0
# Beyond this part of the shortest period, the motion is ambiguous.
_LINEAR_CYCLES = 1 / 6
_BOTH = np.eye(COLUMNS)  # devices


@dataclass(frozen=True)
class Trajectory:
    """The completed share of a motion over time, from 0 to 1.

    It is a step between the frames `first` and `last`, or a linear ramp from the one to the other for a drift.
    """

    first: int
    last: int
    course: MotionCourse = MotionCourse.BUMP

    def at(self, times: Ints) -> Floats:
        """Return the completed share (N,) of the motion in frames (N,)."""
        if self.course is MotionCourse.DRIFT:
            return (times - self.first) / (self.last - self.first)
        return (times >= self.last).astype(np.float64)


def trajectories_of(times: Ints) -> list[Trajectory]:
    """Return all that frames at these times (N,), in order, can tell apart: a slow drift, and bumps between two."""
    bumps = [Trajectory(int(first), int(last)) for first, last in pairwise(times)]
    return [Trajectory(int(times[0]), int(times[-1]), MotionCourse.DRIFT), *bumps]


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
        size_px, measurable_px = self._size_px(fit), _LINEAR_CYCLES * self._finest_period
        first, last = min(trajectory.first for trajectory in likely), max(trajectory.last for trajectory in likely)
        if event.course is MotionCourse.DRIFT:
            first, last = event.first, event.last
        contradicted = self._is_overdetermined and is_significant
        estimate = MotionEstimate(
            motion=fit.motion,
            course=event.course,
            verdict=MotionVerdict.of(
                size_px,
                event.course.largest_px(self._finest_period, explained),
                # Aliasing, ripple and blurred frames differ between pixels: a motion explains few percent of them.
                significant=contradicted and explained > FEW and max(gained) > self._by_late_frame(),
            ),
            first=self._repeats * first,
            last=self._repeats * last,
            size_px=size_px,
            explained=explained,
            shift=self._shift_of(event, fit.motion),
            alternatives=tuple(
                self._shift_of(trajectory, devices @ self._along(trajectory, devices).values) for trajectory in likely
            ),
            measurable_px=measurable_px,
            largest_px=largest_bump_px(self._finest_period),
            is_either_device=is_significant and (undecided or size_px >= measurable_px),
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

    def _shift_of(self, trajectory: Trajectory, motion: Floats) -> CoordinateShift:
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


# Noise reduction by the taps along both axes, as a factor of the variance.
_LESS_NOISE = float(np.sum(LEVEL**2)) ** 2
_MARGIN = len(LEVEL) // 2
# Apparent motion at rest due to ripple: of a single frame, and of the mean of the frames of a fringe.
_OF_A_FRAME_PX, _OF_A_FRINGE_PX = 0.03, 0.01
# One event explains nearly all of its effect; nonlinearity leaves a few hundredths.
_MOST_BY_EVENT = 0.95


@dataclass(frozen=True)
class FrameShifts:
    """Shifts of N frames relative to their mean."""

    times: Ints
    """(N,): places of the frames in the sequence."""
    shift_px: Floats
    """(2, N): shift of the scene to the right and down."""
    covariance: Floats
    """(2 N, 2 N)"""
    by_shifts: float
    """Share of the residuals of a fit of light alone that the shifts explain."""
    by_event: float
    """Share of this that one bump or one even drift explains."""

    @property
    def is_no_event(self) -> bool:
        """Whether the shifts are significant, and not explained by a single event."""
        if self.by_event >= _MOST_BY_EVENT:
            return False
        shifts = self.shift_px.reshape(-1)
        squared = float(shifts @ np.linalg.solve(self.covariance + _OF_A_FRAME_PX**2 * np.eye(shifts.size), shifts))
        return squared > float(scipy.special.chdtri(shifts.size - 2, BY_CHANCE))

    @property
    def are_distinct_from_light(self) -> bool:
        """Whether the shifts explain what changes of light do not, and many frames are shifted.

        A frame with ghosting of the last picture looks as if it and the opposite step were shifted. Shifts explain more
        than 0.75 of the residuals of light where frames were shifted, and less than 0.35 where flicker was left. Two of
        eight independent frames have up to half of the squares, a late frame and its opposite step 0.97.
        """
        squares = np.sort(np.sum(self.shift_px**2, axis=0))
        return self.by_shifts > HALF and float(squares[-2:].sum()) < AS_GOOD * float(squares.sum())

    def between(self, shares: Floats) -> tuple[Floats, Floats]:
        """Return the sum (2,) of shares (N,) of the shifts, and its covariance (2, 2)."""
        both = np.kron(np.eye(2), shares)
        return self.shift_px @ shares, both @ self.covariance @ both.T


def shifts_of_frames(fringes: ObservedFringes, pixels: MotionPixels, by_event: float) -> FrameShifts:
    """Measure the shifts of the frames of all fringes."""
    frames = fringe_frames(fringes.plan)
    count = len(frames.times)
    equations = equations_of_shifts(frames, fringes.tiles, pixels, fringes.noise)
    fit = equations.along(np.eye(2 * count))
    about_mean = np.kron(np.eye(2), np.eye(count) - 1 / count)
    return FrameShifts(
        frames.times,
        (about_mean @ fit.values).reshape(2, count),
        about_mean @ equations.covariance(fit) @ about_mean,
        1.0 - equations.variance(fit.values) / max(equations.variance(), 1e-12),
        by_event,
    )


def equations_of_shifts(
    frames: FringeFrames, tiles: TileSample, pixels: MotionPixels, noise: NoiseModel
) -> FrameEquations:
    """Return the equations for the shift of each frame to the right and down."""
    row, column = np.divmod(pixels.number % TILE_PX**2, TILE_PX)
    inside = (np.minimum(row, column) >= _MARGIN) & (np.maximum(row, column) < TILE_PX - _MARGIN)
    images = tiles.of_frames(frames.times.tolist())
    place = pixels.number[inside]
    levels, right, down = (
        _filtered(images, *taps)[:, place] for taps in ((LEVEL, LEVEL), (LEVEL, SLOPE), (SLOPE, LEVEL))
    )
    model = FringeModel(frames, levels.astype(np.float64))
    variance = _LESS_NOISE * noise.variance(model.light).astype(np.float64)
    return FrameEquations(frames, pixels.tile[inside], (of_frames(model, -np.stack([right, down]), variance),))


def _filtered(images: Floats32, down: Floats, across: Floats) -> Floats32:
    """Filter tiles (N, P) by taps along columns and rows; values within two pixels of a tile's border are undefined."""
    filtered = images.reshape(len(images), -1, TILE_PX, TILE_PX)
    # A matrix product of a few taps made OpenBLAS warn of invalid values that do not exist.
    for axis, taps in ((2, down), (3, across)):
        shifted = (tap * np.roll(filtered, _MARGIN - k, axis) for k, tap in enumerate(taps.astype(np.float32)))
        filtered = reduce(np.add, shifted)
    return filtered.reshape(images.shape)


def moved_one_by_one(
    event: MotionEstimate, plan: SequencePlan, shifts: FrameShifts, pixels: MotionPixels
) -> MotionEstimate:
    """Return the estimate for independent motion of the frames, in place of that of an `event`."""
    x, y = (_shares(axis.fringes[-1], plan, shifts.times) for axis in plan.axes)
    apart, covariance = shifts.between(x - y)
    # Half of it goes to x, and half to y: their common part is equivalent to another pose of the rig.
    half = np.zeros((2, 2, COLUMNS))
    half[0, :, PER_DEVICE : PER_DEVICE + 2] = np.eye(2) / 2
    half[1] = -half[0]

    def shift_by(of: Floats) -> CoordinateShift:
        return replace(event.shift, motions=np.einsum("adc,d->ac", half, of))

    values, vectors = np.linalg.eigh(covariance + 2 * _OF_A_FRINGE_PX**2 * np.eye(2))
    spread = tuple(shift_by(sqrt(max(value, 0.0)) * vector) for value, vector in zip(values, vectors.T, strict=True))
    typical = np.zeros(COLUMNS)
    typical[PER_DEVICE : PER_DEVICE + 2] = np.sqrt(np.mean(shifts.shift_px**2, axis=1))
    size_px = float(np.sqrt(np.mean(np.sum((pixels.gradient @ shifts.shift_px) ** 2, axis=1))))
    course = MotionCourse.FRAME_BY_FRAME
    return replace(
        event,
        motion=typical,
        course=course,
        verdict=MotionVerdict.of(size_px, course.largest_px(0.0, 1.0), significant=True),
        first=plan.repeats * int(shifts.times[0]),
        last=plan.repeats * int(shifts.times[-1]),
        size_px=size_px,
        shift=shift_by(apart),
        alternatives=(),
        unseen=spread,
    )


def _shares(fringe: Fringe, plan: SequencePlan, times: Ints) -> Floats:
    """Return the share (N,) of the shift of each frame in the coordinate from a fringe, averaged over its phases."""
    shares = np.zeros(len(times))
    of_frame = np.sum(fringe.weights[1:] * fringe.design[:, 1:].T, axis=0) / 2
    for k, number in enumerate(fringe.frames):
        shares[times == plan.shown.index(number)] = of_frame[k]
    return shares


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
    if not shifts.is_no_event or not (estimate.is_significant or shifts.are_distinct_from_light):
        return estimate
    one_by_one = moved_one_by_one(estimate, plan, shifts, pixels)
    # Large shifts of single frames prove nothing: a bump by many px is not linear, so that no single event explains it
    # either.
    both_too_large = {estimate.verdict, one_by_one.verdict} == {MotionVerdict.TOO_LARGE}
    return estimate if both_too_large else one_by_one
