"""Frames that are each somewhere else: hand-held cameras, and software that steadies pictures one by one.

No event in time explains such motion, but it is small, and each frame tells of its own (`frame_equations`): thousands
of pixels tell it by least squares. What all frames have in common, nobody sees.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.stats import chi2

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints, median
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.found import Disturbance, MotionFound
from scanner.decoding.motion.frame_equations import FrameEquations, frame_equations
from scanner.decoding.motion.pixels import Pixels
from scanner.decoding.motion.rigid import COLUMNS, PER_DEVICE
from scanner.decoding.motion.tile_sample import TileSample
from scanner.decoding.motion.trajectories import Trajectory
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import BY_CHANCE, HUBER_SIGMAS

# Expected of shifts, in px, and of gains: what no pixel tells of stays small.
_PRIOR = 1.0
_ROUNDS = 3
# What ripple makes of a single frame at rest, and of the mean of those of a fringe, as between halves.
_OF_A_FRAME_PX, _OF_A_FRINGE_PX = 0.03, 0.01
# Of what contradicts rest beside light, in squares: shifts explain more than 0.75 where frames were shifted, and less
# than 0.35 where light that flickered was not told.
_LEAST_BY_SHIFTS = 0.5
# In squares, two of eight frames that are each elsewhere have up to half; one that is late and its opposite step 0.97.
_MOST_OF_TWO = 0.75
# One event explains all of what frames that it moved show; what is not linear about it is some hundredths.
_MOST_BY_EVENT = 0.95


@dataclass(frozen=True)
class FrameShifts:
    """Of N frames, taken as number `times` (N,) of the sequence: how far each shows the scene to the right and down,
    `shift_px` (2, N), about their mean; with the `covariance` (2 N, 2 N) of these. `by_shifts`: the share that they
    explain of what light leaves. `by_event`: how much of what they explain one bump or one even drift of both devices
    explains.
    """

    times: Ints
    shift_px: Floats
    covariance: Floats
    by_shifts: float
    by_event: float

    @property
    def is_no_event(self) -> bool:
        """Whether they differ by more than chance, and explain what no single event does."""
        if self.by_event >= _MOST_BY_EVENT:
            return False
        shifts = self.shift_px.reshape(-1)
        squared = float(shifts @ np.linalg.solve(self.covariance + _OF_A_FRAME_PX**2 * np.eye(shifts.size), shifts))
        return squared > chi2.isf(BY_CHANCE, shifts.size - 2)

    @property
    def are_told_from_light(self) -> bool:
        """Whether they explain what light does not, and are of many frames: one that shows some of the last picture is
        as if it and its opposite step were elsewhere.
        """
        squares = np.sort(np.sum(self.shift_px**2, axis=0))
        return self.by_shifts > _LEAST_BY_SHIFTS and float(squares[-2:].sum()) < _MOST_OF_TWO * float(squares.sum())

    def between(self, shares: Floats) -> tuple[Floats, Floats]:
        """The sum (2,) of shares (N,) of the shifts, and its covariance (2, 2)."""
        both = np.kron(np.eye(2), shares)
        return self.shift_px @ shares, both @ self.covariance @ both.T


def shifts_of_frames(plan: SequencePlan, tiles: TileSample, noise: NoiseModel, saturation: float) -> FrameShifts | None:
    """How far the frames of all fringes are moved against each other; None where too few pixels tell."""
    equations = frame_equations(plan, tiles, noise, saturation)
    return None if equations is None else _solved(equations)


def _solved(equations: FrameEquations) -> FrameShifts:
    """Robust least squares, with the scatter of tiles as the covariance."""
    count = len(equations.times)
    columns = np.concatenate([equations.by_camera, equations.by_light, equations.by_projector])
    design, seen = columns.reshape(len(columns), -1), equations.seen.reshape(-1)
    expected = np.eye(len(columns)) / _PRIOR**2
    # All to the right, all down, all brighter: nothing tells of that.
    alike = 4 * count
    expected[:alike, :alike] += np.sum(design**2) * np.kron(np.eye(4), np.full((count, count), 1 / count))
    asked = slice(0, len(columns) - count)
    light = slice(2 * count, len(columns) - count)
    found, left, weight, inverse = _robust(design[asked], seen, expected[asked, asked])
    _, left_by_light, *_ = _robust(design[light], seen, expected[light, light])
    normal, right = (design * weight) @ design.T + expected, (design * weight) @ seen
    scores = (design[asked] * (weight * left)).reshape(columns[asked].shape).sum(axis=1)
    _, group = np.unique(equations.tile, return_inverse=True)
    sums = np.stack([np.bincount(group, of_unknown) for of_unknown in scores])
    covariance = (inverse @ (sums @ sums.T) @ inverse)[: 2 * count, : 2 * count]
    about_mean = np.kron(np.eye(2), np.eye(count) - 1 / count)
    return FrameShifts(
        equations.times,
        (about_mean @ found[: 2 * count]).reshape(2, count),
        about_mean @ covariance @ about_mean,
        1.0 - (_scale(left) / max(_scale(left_by_light), 1e-9)) ** 2,
        _by_event(equations, normal, right),
    )


def _robust(design: Floats, seen: Floats, expected: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The unknowns (U,) that explain what is seen (M,); what is left, its weights (M,), the inverse normal matrix."""
    weight: Floats = np.ones(len(seen))
    for _ in range(_ROUNDS):
        weighted = design * weight
        inverse: Floats = np.asarray(np.linalg.inv(weighted @ design.T + expected), np.float64)
        found = inverse @ (weighted @ seen)
        left = seen - found @ design
        weight = np.minimum(1.0, HUBER_SIGMAS * _scale(left) / np.maximum(np.abs(left), 1e-9))
    return found, left, weight, inverse


def _scale(left: Floats) -> float:
    """The standard deviation of what is left (M,), but for what is far off."""
    return SIGMA_PER_MEDIAN * float(median(np.abs(left)))


def _by_event(equations: FrameEquations, normal: Floats, right: Floats) -> float:
    """How much of what the shifts of all frames explain one event does, which moves both devices' pictures."""
    count = len(equations.times)
    unit = np.eye(len(right))
    camera, light, projector = np.split(unit, [2 * count, len(right) - count], axis=1)

    def explained(by: Floats) -> float:
        asked = np.concatenate([by, light], axis=1)
        towards = asked.T @ right
        return float(towards @ np.linalg.solve(asked.T @ normal @ asked, towards))

    times = equations.times
    trajectories = [Trajectory(int(times[0]), int(times[-1]), slow=True)]
    trajectories += [Trajectory(int(time) - 1, int(time)) for time in times[1:]]

    def of_event(trajectory: Trajectory) -> Floats:
        share = trajectory.at(times) - np.mean(trajectory.at(times))
        along = [projector @ (share * (equations.axis == axis)) for axis in (0, 1)]
        return np.stack([camera[:, :count] @ share, camera[:, count:] @ share, *along], axis=1)

    nothing = explained(camera[:, :0])
    best = max(explained(of_event(trajectory)) for trajectory in trajectories)
    return (best - nothing) / max(explained(camera) - nothing, 1e-12)


def moved_one_by_one(found: MotionFound, plan: SequencePlan, shifts: FrameShifts, pixels: Pixels) -> MotionFound:
    """What single frames were moved by, in the place of the event that was `found`."""
    x, y = (_shares(axis.fringes[-1], plan, shifts.times) for axis in plan.axes)
    apart, covariance = shifts.between(x - y)
    # Half of it for x, and half of it for y: what both have in common is as if the rig had stood there.
    half = np.zeros((2, 2, COLUMNS))
    half[0, :, PER_DEVICE : PER_DEVICE + 2] = np.eye(2) / 2
    half[1] = -half[0]

    def disturbance(of: Floats) -> Disturbance:
        return replace(found.shift, motions=np.einsum("adc,d->ac", half, of))

    values, vectors = np.linalg.eigh(covariance + 2 * _OF_A_FRINGE_PX**2 * np.eye(2))
    spread = tuple(disturbance(sqrt(max(value, 0.0)) * vector) for value, vector in zip(values, vectors.T, strict=True))
    typical = np.zeros(COLUMNS)
    typical[PER_DEVICE : PER_DEVICE + 2] = np.sqrt(np.mean(shifts.shift_px**2, axis=1))
    return replace(
        found,
        motion=typical,
        significant=True,
        slow=False,
        one_by_one=True,
        first=plan.repeats * int(shifts.times[0]),
        last=plan.repeats * int(shifts.times[-1]),
        size_px=float(np.sqrt(np.mean(np.sum((pixels.gradient @ shifts.shift_px) ** 2, axis=1)))),
        shift=disturbance(apart),
        others=(),
        unseen=spread,
    )


def _shares(fringe: Fringe, plan: SequencePlan, times: Ints) -> Floats:
    """The share (N,) of the shift of each frame in the coordinate by a fringe, averaged over its phases."""
    shares = np.zeros(len(times))
    angles = 2 * np.pi * np.array(fringe.shifts)
    of_frame = (fringe.weights[1] * np.cos(angles) - fringe.weights[2] * np.sin(angles)) / 2
    for k, number in enumerate(fringe.frames):
        shares[times == plan.shown.index(number)] = of_frame[k]
    return shares
