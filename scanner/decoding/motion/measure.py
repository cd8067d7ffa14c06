"""Did camera or projector move while the fringes were taken? When, how far, and what that does to the coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.numerics import Floats
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.courses import Course, Showing, Showings, showings_of, told
from scanner.decoding.motion.found import Disturbance, MotionFound
from scanner.decoding.motion.pixels import Pixels, choose_pixels
from scanner.decoding.motion.rigid import Fit, fit_motion, shifts_by_motion
from scanner.decoding.motion.tile_sample import TileSample
from scanner.decoding.sequence_plan import SequencePlan

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
# Offset, amplitude and phase.
_PARAMETERS = 3
# A course that explains so much of what the best one does may be the true one.
_NEARLY = 0.8


@dataclass(frozen=True)
class _Tried:
    """A course with the motion that fits best; `moved_px`, `variance` (P, 2): of the pixels' coordinates.

    `shares` (2,): of the motion that x and y have taken part in, less what they have in common, which is as if the rig
    had stood there.
    """

    course: Course
    fit: Fit
    moved_px: Floats
    variance: Floats
    shares: Floats

    @property
    def size_px(self) -> float:
        """How far the coordinates surely moved: root mean square."""
        sure = np.maximum(self.moved_px**2 - _SURE**2 * self.variance, 0.0)
        return float(np.sqrt(np.mean(np.sum(sure, axis=1))))

    @property
    def is_significant(self) -> bool:
        """Whether it is more than what is measured at rest."""
        return self.fit.significance > _SIGNIFICANT and self.size_px > _LEAST_PX


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
        self._sizes = (tiles.shape[1], tiles.shape[0]), projector_size
        self._showings = showings_of(plan, tiles, pixels)
        self._design = shifts_by_motion(pixels.camera_px, pixels.projector_px, pixels.gradient, *self._sizes)
        self._times = sorted({int(time) for axis in self._showings for one in axis for time in one.times})

    def measure(self) -> MotionFound:
        """The motion that explains the fringes best, and what may be the truth beside it."""
        slow = Course(self._times[0], self._times[-1], slow=True)
        bumps = [Course(first, last) for first, last in pairwise(self._times)]
        tried = [self._try(course) for course in [slow, *bumps[::_STRIDE]]]
        best = max(tried, key=lambda one: one.fit.gained)
        if best.is_significant:
            tried += [self._try(course) for course in bumps[1::_STRIDE]]
            best = max(tried, key=lambda one: one.fit.gained)
        likely = [one for one in tried if one.fit.gained >= _NEARLY * best.fit.gained]
        refined = self._refined(best) if best.is_significant else best
        explained = self._explained(refined)
        shift, *others = (Disturbance(np.outer(one.shares, one.fit.motion), *self._sizes) for one in (refined, *likely))
        first, last = min(one.course.first for one in likely), max(one.course.last for one in likely)
        return MotionFound(
            motion=refined.fit.motion,
            significant=self._is_overdetermined and best.is_significant and explained > _LEAST_EXPLAINED,
            slow=best.course.slow,
            first=self._repeats * (best.course.first if best.course.slow else first),
            last=self._repeats * (best.course.last if best.course.slow else last),
            size_px=refined.size_px,
            explained=explained,
            shift=shift,
            others=tuple(others),
            witnessed=self._is_witnessed,
        )

    @property
    def _is_overdetermined(self) -> bool:
        """Whether a frame that does not belong to its fringe shows; with three, a bent curve is in the phase."""
        return all(len(one.times) > _PARAMETERS for axis in self._showings for one in axis)

    @property
    def _is_witnessed(self) -> bool:
        """Whether what moves between the axes shows: each was measured before and after the other, or in part."""
        x, y = (np.concatenate([one.times for one in axis]) for axis in self._showings)
        return bool(x.min() < y.max() and y.min() < x.max())

    def _try(self, course: Course) -> _Tried:
        return self._tried(course, self._fit(self._showings, course))

    def _fit(self, showings: Showings, course: Course) -> Fit:
        seen = told(self._showings, showings, self._pixels, course)
        design = self._design[seen.pixel, seen.axis]
        return fit_motion(design, seen.motion_px, seen.precision, self._pixels.tile[seen.pixel])

    def _tried(self, course: Course, fit: Fit) -> _Tried:
        moved_px = self._design @ fit.motion
        shares = np.array([_share(axis, course) for axis in self._showings])
        squares = np.mean(moved_px**2, axis=0)
        common = float(shares @ squares / max(float(squares.sum()), 1e-12))
        variance = np.einsum("pac,cd,pad->pa", self._design, fit.covariance, self._design)
        return _Tried(course, fit, moved_px, variance, shares - common)

    def _moved(self, tried: _Tried) -> Showings:
        x, y = (
            tuple(one.moved(tried.course, tried.moved_px[:, axis]) for one in self._showings[axis]) for axis in (0, 1)
        )
        return x, y

    def _refined(self, tried: _Tried) -> _Tried:
        """The same where it is too far for first order (Gauss–Newton)."""
        for _ in range(_ROUNDS):
            more = self._fit(self._moved(tried), tried.course)
            fit = Fit(tried.fit.motion + more.motion, more.covariance, tried.fit.gained)
            tried = self._tried(tried.course, fit)
        return tried

    def _explained(self, tried: _Tried) -> float:
        """The share of what the fringes show of the course that the motion explains, of a typical pixel."""
        before, after = (
            told(self._showings, showings, self._pixels, tried.course)
            for showings in (self._showings, self._moved(tried))
        )
        if not len(before.pixel):
            return 0.0
        left, all_of_it = (float(np.median(seen.precision * seen.motion_px**2)) for seen in (after, before))
        return 1.0 - left / max(all_of_it, 1e-12)


def _share(fringes: Sequence[Showing], course: Course) -> float:
    """The share of the motion in the coordinate: that in the most certain fringe, to whose mean others are brought."""
    surest = min(fringes, key=lambda one: float(np.median(one.fit.variance)))
    return float(np.mean(surest.fit.follow(course.at(surest.times)).response))


def measure_motion(
    accumulators: Accumulators,
    tiles: TileSample,
    noise: NoiseModel,
    saturation: float,
    projector_size: tuple[int, int],
) -> MotionFound | None:
    """The motion during a capture; None where too little of it is fringes on smooth surfaces."""
    pixels = choose_pixels(accumulators, tiles, noise, saturation)
    if pixels is None:
        return None
    return MotionMeter(accumulators.plan, tiles, pixels, projector_size).measure()
