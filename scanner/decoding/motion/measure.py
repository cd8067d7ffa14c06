"""Measurement of camera or projector motion between fringe frames: its time, its size and its effect on the
coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, median
from scanner.decoding.axis_signals import Signals
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.device_motion import LEAST_PX, Disturbance, MotionFound, largest_bump_px
from scanner.decoding.motion.fringe_fit import FringeFit
from scanner.decoding.motion.pixels import Pixels, choose_pixels
from scanner.decoding.motion.rigid import COLUMNS, PER_DEVICE, Fit, fit_motion, shifts_by_motion
from scanner.decoding.motion.single_frames import moved_one_by_one, shifts_of_frames
from scanner.decoding.motion.trajectories import MotionObserver, Trajectory, fits_of
from scanner.decoding.samples import TileSample
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, SequencePlan
from scanner.decoding.significance import AS_GOOD, NEARLY_ALL, OUTLYING_SIGMAS

# Significance that interreflection and ripple do not reach at rest.
_SIGNIFICANT = 8.0
# Motion explains the residuals of a typical pixel; aliasing and ripple differ between pixels.
_LEAST_EXPLAINED = 0.03
_ROUNDS = 3  # of Gauss–Newton
# Beyond this part of the shortest period, the motion is ambiguous.
_LINEAR_CYCLES = 1 / 6


@dataclass(frozen=True)
class _Candidate:
    """A trajectory with the motion that fits it best."""

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
        self._fits = fits_of(plan, tiles, pixels)
        self._observer = MotionObserver(self._fits, pixels)
        by_motion = shifts_by_motion(pixels.camera_px, pixels.projector_px, pixels.gradient, *self._sizes)
        # The shifts of x of all pixels, then those of y.
        self._design = np.concatenate([by_motion[:, 0], by_motion[:, 1]])
        self._tile = np.tile(pixels.tile, 2)
        self._times = sorted({int(time) for axis in self._fits for one in axis for time in one.times})

    def measure(self) -> tuple[MotionFound, bool]:
        """Return the motion that explains the fringes best, with the alternatives to it, and whether the fringes
        contradict rest.

        The latter may hold even if no single event explains the contradiction.
        """
        slow = Trajectory(self._times[0], self._times[-1], slow=True)
        bumps = [Trajectory(first, last) for first, last in pairwise(self._times)]
        # A bump next to a boundary between frames is found there as well: at rest, half of them are enough.
        candidates = [self._try(trajectory) for trajectory in [slow, *bumps[::2]]]
        best = max(candidates, key=lambda one: one.fit.gained)
        if self._is_significant(best):
            candidates += [self._try(trajectory) for trajectory in bumps[1::2]]
            best = max(candidates, key=lambda one: one.fit.gained)
        likely = [one for one in candidates if one.fit.gained >= AS_GOOD * best.fit.gained]
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
        """Return whether either device alone explains about as much as the other, as before a scene of little depth."""
        devices = np.arange(COLUMNS) // PER_DEVICE
        gained = [self._fit(self._observer, trajectory, self._design * (devices == device)).gained for device in (0, 1)]
        return min(gained) > NEARLY_ALL * max(gained)

    @property
    def _is_overdetermined(self) -> bool:
        """Whether every fringe has enough frames to reveal an outlier frame; with three, a nonlinear curve only shifts
        the phase.
        """
        return all(len(one.times) > COSINE_PARAMETERS for axis in self._fits for one in axis)

    def _try(self, trajectory: Trajectory) -> _Candidate:
        return _Candidate(trajectory, self._fit(self._observer, trajectory, self._design))

    def _fit(self, observer: MotionObserver, trajectory: Trajectory, design: Floats) -> Fit:
        observed = observer.observe(trajectory)
        return fit_motion(design, observed.motion_px, observed.precision, observed.row, self._tile)

    def _is_significant(self, candidate: _Candidate) -> bool:
        """Return whether the motion exceeds what is measured at rest."""
        return candidate.fit.significance > _SIGNIFICANT and self._size_px(candidate.fit) > LEAST_PX

    def _size_px(self, fit: Fit) -> float:
        """Return the root mean square shift of the coordinates beyond its uncertainty."""
        variance = np.einsum("rc,rc->r", self._design @ fit.covariance, self._design)
        sure = np.maximum((self._design @ fit.motion) ** 2 - OUTLYING_SIGMAS**2 * variance, 0.0)
        return float(np.sqrt(2 * np.mean(sure)))

    def _disturbance(self, candidate: _Candidate) -> Disturbance:
        """Return the motion that x and y each contain, averaged over their fringes, without their common part.

        The common part is equivalent to another pose of the rig.
        """
        shares = np.array([_share(axis, candidate.trajectory) for axis in self._fits])
        squares = np.array([np.mean(moved_px**2) for moved_px in self._moved_px(candidate.fit)])
        common = float(shares @ squares / max(float(squares.sum()), 1e-12))
        return Disturbance(np.outer(shares - common, candidate.fit.motion), *self._sizes)

    def _moved_px(self, fit: Fit) -> list[Floats]:
        """Return how far the coordinates of the pixels (P,) moved, for x and for y."""
        return np.split(self._design @ fit.motion, 2)

    def _with_known_motion(self, candidate: _Candidate) -> MotionObserver:
        x, y = (
            tuple(one.with_known_motion(candidate.trajectory.at(one.times), moved_px) for one in axis)
            for axis, moved_px in zip(self._fits, self._moved_px(candidate.fit), strict=True)
        )
        return MotionObserver((x, y), self._pixels)

    def _refined(self, candidate: _Candidate) -> _Candidate:
        """Refine a motion beyond first order (Gauss–Newton)."""
        for _ in range(_ROUNDS):
            more = self._fit(self._with_known_motion(candidate), candidate.trajectory, self._design)
            candidate = _Candidate(
                candidate.trajectory, Fit(candidate.fit.motion + more.motion, more.covariance, candidate.fit.gained)
            )
        return candidate

    def _explained(self, candidate: _Candidate) -> float:
        """Return the share of the observed motion along the trajectory that the fit explains, at a typical pixel."""
        before, after = (
            observer.observe(candidate.trajectory) for observer in (self._observer, self._with_known_motion(candidate))
        )
        if not len(before.row):
            return 0.0
        left, all_of_it = (median(observed.precision * observed.motion_px**2) for observed in (after, before))
        return 1.0 - left / max(all_of_it, 1e-12)


def _share(fringes: Sequence[FringeFit], trajectory: Trajectory) -> float:
    """Return the share of the motion in the coordinate: that of the shortest fringe, which determines it
    (`fringes/systematic_error.py`).
    """
    shortest = fringes[-1]
    return float(np.mean(shortest.response_to(trajectory.at(shortest.times)).response))


def measure_motion(
    plan: SequencePlan,
    tiles: TileSample,
    signals: tuple[Signals, Signals],
    noise: NoiseModel,
    saturation: float,
    projector_size: tuple[int, int],
) -> MotionFound | None:
    """Return the motion during a capture, from the signals of its tiles; None if too few smooth pixels see fringes."""
    pixels = choose_pixels(plan, tiles, signals, noise, saturation)
    if pixels is None:
        return None
    found, contradicted = MotionMeter(plan, tiles, pixels, projector_size).measure()
    shifts = shifts_of_frames(plan, tiles, noise, saturation) if contradicted else None
    if shifts is None or not shifts.is_no_event or not (found.significant or shifts.are_distinct_from_light):
        return found
    one_by_one = moved_one_by_one(found, plan, shifts, pixels)
    # Large shifts of single frames prove nothing: a bump by many px is not linear, so that no single event explains it
    # either.
    return found if found.is_too_large and one_by_one.is_too_large else one_by_one
