"""Did camera or projector move while the fringes were taken? When, how far, and what that does to the coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, median
from scanner.decoding.axis_signals import Signals
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.found import Disturbance, MotionFound, largest_bump_px
from scanner.decoding.motion.pixels import Pixels, choose_pixels
from scanner.decoding.motion.rigid import COLUMNS, PER_DEVICE, Fit, fit_motion, shifts_by_motion
from scanner.decoding.motion.single_frames import moved_one_by_one, shifts_of_frames
from scanner.decoding.motion.tile_sample import TileSample
from scanner.decoding.motion.trajectories import FringeObservation, MotionObserver, Trajectory, observations_of
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, SequencePlan

# A bump is looked for at every so many boundaries between frames first: one next to it shows there as well.
_STRIDE = 2
# From so many standard deviations on, and so many px, it is more than interreflection and ripple make at rest.
_SIGNIFICANT = 8.0
# A part of the motion counts where it is beyond so many of its standard deviations.
_SURE = 3.0
_LEAST_PX = 0.02
# A motion explains what a typical pixel shows; aliasing and ripple are other at each.
_LEAST_EXPLAINED = 0.03
_ROUNDS = 3
# Beyond such a part of the shortest period, other parts of periods explain the same.
_LINEAR_CYCLES = 1 / 6
# A course that explains so much of what the best one does may be the true one.
_NEARLY = 0.8
# A device that explains so much of what the other one does may be the one that moved.
_AS_WELL = 0.9


@dataclass(frozen=True)
class _Candidate:
    """A course with the motion that fits best."""

    trajectory: Trajectory
    fit: Fit


class MotionMeter:
    """Measures motion in the fringes of a capture; sizes are (width, height)."""

    def __init__(
        self,
        plan: SequencePlan,
        tiles: TileSample,
        pixels: Pixels,
        projector_size: tuple[int, int],
    ) -> None:
        self._pixels, self._repeats = pixels, plan.repeats
        self._finest_period = min(fringe.period for fringe in plan.fringes)
        self._sizes = (tiles.shape[1], tiles.shape[0]), projector_size
        self._observations = observations_of(plan, tiles, pixels)
        self._observer = MotionObserver(self._observations, pixels)
        by_motion = shifts_by_motion(pixels.camera_px, pixels.projector_px, pixels.gradient, *self._sizes)
        # Of all pixels the shifts of x, then of all those of y.
        self._design = np.concatenate([by_motion[:, 0], by_motion[:, 1]])
        self._tile = np.tile(pixels.tile, 2)
        self._times = sorted({int(time) for axis in self._observations for one in axis for time in one.times})

    def measure(self) -> tuple[MotionFound, bool]:
        """The motion that explains the fringes best, and what may be the truth beside it; and whether they contradict
        rest, if only by what no single event explains.
        """
        slow = Trajectory(self._times[0], self._times[-1], slow=True)
        bumps = [Trajectory(first, last) for first, last in pairwise(self._times)]
        candidates = [self._try(trajectory) for trajectory in [slow, *bumps[::_STRIDE]]]
        best = max(candidates, key=lambda one: one.fit.gained)
        if self._is_significant(best):
            candidates += [self._try(trajectory) for trajectory in bumps[1::_STRIDE]]
            best = max(candidates, key=lambda one: one.fit.gained)
        likely = [one for one in candidates if one.fit.gained >= _NEARLY * best.fit.gained]
        is_significant = self._is_significant(best)
        refined = self._refined(best) if is_significant else best
        explained = self._explained(refined) if is_significant else 0.0
        shift, *others = (self._disturbance(one) for one in (refined, *likely))
        size_px = self._size_px(refined.fit)
        linear = size_px < _LINEAR_CYCLES * self._finest_period
        first, last = min(one.trajectory.first for one in likely), max(one.trajectory.last for one in likely)
        contradicted = self._is_overdetermined and is_significant
        found = MotionFound(
            motion=refined.fit.motion,
            significant=contradicted and explained > _LEAST_EXPLAINED,
            slow=best.trajectory.slow,
            first=self._repeats * (best.trajectory.first if best.trajectory.slow else first),
            last=self._repeats * (best.trajectory.last if best.trajectory.slow else last),
            size_px=size_px,
            explained=explained,
            shift=shift,
            others=tuple(others),
            largest_px=largest_bump_px(self._finest_period),
            linear=linear,
            undecided=is_significant and (not linear or self._is_undecided(best.trajectory)),
        )
        return found, contradicted

    def _is_undecided(self, trajectory: Trajectory) -> bool:
        """Whether the camera alone explains about as much as the projector alone, as before a scene of little depth."""
        observed, devices = self._observer.observe(trajectory), np.arange(COLUMNS) // PER_DEVICE
        gained = [
            fit_motion(
                self._design * (devices == device), observed.motion_px, observed.precision, observed.row, self._tile
            ).gained
            for device in (0, 1)
        ]
        return min(gained) > _AS_WELL * max(gained)

    @property
    def _is_overdetermined(self) -> bool:
        """Whether a frame that does not belong to its fringe shows; with three, a bent curve is in the phase."""
        return all(len(one.times) > COSINE_PARAMETERS for axis in self._observations for one in axis)

    def _try(self, trajectory: Trajectory) -> _Candidate:
        return _Candidate(trajectory, self._fit(self._observer, trajectory))

    def _fit(self, observer: MotionObserver, trajectory: Trajectory) -> Fit:
        observed = observer.observe(trajectory)
        return fit_motion(self._design, observed.motion_px, observed.precision, observed.row, self._tile)

    def _is_significant(self, candidate: _Candidate) -> bool:
        """Whether it is more than what is measured at rest."""
        return candidate.fit.significance > _SIGNIFICANT and self._size_px(candidate.fit) > _LEAST_PX

    def _size_px(self, fit: Fit) -> float:
        """How far the coordinates surely moved: root mean square."""
        variance = np.einsum("rc,rc->r", self._design @ fit.covariance, self._design)
        sure = np.maximum((self._design @ fit.motion) ** 2 - _SURE**2 * variance, 0.0)
        return float(np.sqrt(2 * np.mean(sure)))

    def _disturbance(self, candidate: _Candidate) -> Disturbance:
        """What x and y have taken part in, averaged over their fringes, less what they have in common, which is as if
        the rig had stood there.
        """
        shares = np.array([_share(axis, candidate.trajectory) for axis in self._observations])
        squares = np.array([np.mean(moved_px**2) for moved_px in self._moved_px(candidate.fit)])
        common = float(shares @ squares / max(float(squares.sum()), 1e-12))
        return Disturbance(np.outer(shares - common, candidate.fit.motion), *self._sizes)

    def _moved_px(self, fit: Fit) -> list[Floats]:
        """Of x and of y, how far the coordinates of the pixels (P,) moved."""
        return np.split(self._design @ fit.motion, 2)

    def _with_known_motion(self, candidate: _Candidate) -> MotionObserver:
        x, y = (
            tuple(one.with_known_motion(candidate.trajectory, moved_px) for one in axis)
            for axis, moved_px in zip(self._observations, self._moved_px(candidate.fit), strict=True)
        )
        return MotionObserver((x, y), self._pixels)

    def _refined(self, candidate: _Candidate) -> _Candidate:
        """The same where it is too far for first order (Gauss–Newton)."""
        for _ in range(_ROUNDS):
            more = self._fit(self._with_known_motion(candidate), candidate.trajectory)
            candidate = _Candidate(
                candidate.trajectory, Fit(candidate.fit.motion + more.motion, more.covariance, candidate.fit.gained)
            )
        return candidate

    def _explained(self, candidate: _Candidate) -> float:
        """The share of what the fringes show of the course that the motion explains, of a typical pixel."""
        before, after = (
            observer.observe(candidate.trajectory) for observer in (self._observer, self._with_known_motion(candidate))
        )
        if not len(before.row):
            return 0.0
        left, all_of_it = (median(observed.precision * observed.motion_px**2) for observed in (after, before))
        return 1.0 - left / max(all_of_it, 1e-12)


def _share(fringes: Sequence[FringeObservation], trajectory: Trajectory) -> float:
    """The share of the motion in the coordinate: that in the shortest fringe, to whose mean others are brought
    (`fringes/systematic_error.py`).
    """
    shortest = fringes[-1]
    return float(np.mean(shortest.fit.response_to(trajectory.at(shortest.times)).response))


def measure_motion(
    plan: SequencePlan,
    tiles: TileSample,
    signals: tuple[Signals, Signals],
    noise: NoiseModel,
    saturation: float,
    projector_size: tuple[int, int],
) -> MotionFound | None:
    """The motion during a capture, given the signals of its tiles; None where too few fringes are on smooth places."""
    pixels = choose_pixels(plan, tiles, signals, noise, saturation)
    if pixels is None:
        return None
    found, contradicted = MotionMeter(plan, tiles, pixels, projector_size).measure()
    shifts = shifts_of_frames(plan, tiles, noise, saturation) if contradicted else None
    if shifts is None or not shifts.is_no_event or not (found.significant or shifts.are_told_from_light):
        return found
    one_by_one = moved_one_by_one(found, plan, shifts, pixels)
    # Shifts that are not small prove nothing: what no single event explains is that a bump by many px is not linear.
    return found if found.is_too_large and one_by_one.is_too_large else one_by_one
