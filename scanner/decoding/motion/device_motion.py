"""The measured motion of camera or projector during a capture, its effect on the coordinates, and what is said of it.

Shifts that grow as the period shortens look like a motion between two periods: where software resamples frames by a
fraction of a pixel, linear interpolation shifts long waves correctly, but short ones lag behind with the square of
their frequency. The fringes of one period then disagree with those of the next, smoothly over whole surfaces, as if a
device had been knocked exactly between them. The two causes cannot be distinguished.
"""

from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt

from calib.estimation import Shifts
from calib.finding import Finding, FindingKind, Severity
from calib.numerics import CUBIC, Floats
from calib.refusal import RefusalError
from scanner.decoding.motion.code_shift import CodeShift
from scanner.decoding.motion.rigid_motion import CoordinateShift, moved_device, turns_px
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import AS_GOOD, FEW, HALF
from scanner.errors import InputError
from scanner.shown_text import capitalised

# Least size of a motion, which interreflection, ripple and noise do not reach at rest.
LEAST_PX = 0.02
# Largest correction without confirmation: of a motion between the axes, or one that explains little.
_LARGEST_BUMP_PX = 0.35
# Share of the shortest period. Sizes can be measured up to a sixth of it (measure.py), but a bump within a fringe also
# leaves a ripple of up to a quarter of itself in single matches.
_LARGEST_CYCLES = 1 / 8
# Each fringe sees only a part of a drift. A larger one shifts coordinates beyond the linear range of their gradient.
_LARGEST_PX = 3.0
# For independent frames: half a radian of a fringe of six pixels, beyond which it is no longer linear.
_LARGEST_OF_FRAMES_PX = 0.5
# Jitter of single frames ripples a fringe. The part that is alike over whole surfaces is this share of the motion:
# 0.001 to 0.002 px of 0.2 to 0.3, for each polynomial, in three simulated rooms.
_LEFT_OF_SINGLE_FRAMES = 0.006


@dataclass(frozen=True)
class MotionEstimate:
    """The motion that best explains the fringes of a capture."""

    motion: Floats
    """(8,): as in `rigid`; the root mean square if each frame moved by itself."""
    significant: bool
    """Whether it exceeds what is measured at rest."""
    slow: bool
    """Whether it is an even drift rather than a bump between two frames."""
    first: int
    """The frame before the bump, or the first of the drift."""
    last: int
    """The frame after the bump, or the last of the drift."""
    size_px: float
    """How far it moved the coordinates."""
    explained: float
    """The share it explains of the contradiction of rest."""
    shift: CoordinateShift
    """The resulting shift of x and y against each other; of the means over the fringes if each frame moved by itself.

    """
    alternatives: tuple[CoordinateShift, ...]
    """The shifts by other trajectories that fit about as well."""
    unseen: tuple[CoordinateShift, ...] = ()
    """Possible undetected shifts, one standard deviation each."""
    blind: bool = False
    """Whether the frames cannot show a turn of a device between the axes."""
    largest_px: float = _LARGEST_BUMP_PX
    """The largest bump that is corrected."""
    linear: bool = True
    """Whether it is small enough for its size to be measured."""
    undecided: bool = False
    """Whether the other device alone may have moved instead."""
    one_by_one: bool = False
    """Whether each frame moved independently."""

    @property
    def is_too_large(self) -> bool:
        """Whether the motion is too large for matches to be corrected."""
        if self.one_by_one:
            return self.significant and self.size_px > _LARGEST_OF_FRAMES_PX
        largest_px = _LARGEST_PX if self.slow else self.largest_px
        # Drifts explain 80 to 90 % of the contradiction of rest. One that explains a third is a bump of many px.
        if self.explained < HALF:
            largest_px = min(largest_px, _LARGEST_BUMP_PX)
        return self.significant and self.size_px > largest_px

    @property
    def shifts(self) -> Shifts:
        """Return the shifts that may remain in the matches after the correction."""
        likely = []
        if self.significant:
            likely = [
                (alternative.motions - self.shift.motions) / sqrt(len(self.alternatives))
                for alternative in self.alternatives
            ]
            likely.append(FEW * self.shift.motions)
        return Shifts(
            likely=tuple(replace(self.shift, motions=motions).shifts for motions in likely),
            possible=tuple(shift.shifts for shift in self.unseen),
        )

    def __str__(self) -> str:
        """Describe the motion, for example: the projector moved by 1.2 px between frames 18 and 24."""
        if self.one_by_one:
            _, px = turns_px(self.motion)
            return f"the camera's frames are each somewhere else, by {px:.2g} px"
        when = "slowly, from frame {} to {}" if self.slow else "between frames {} and {}"
        return f"{self._description()} {when.format(self.first, self.last)}"

    def _description(self) -> str:
        """Describe which device moved, and how far. A large size is a lower bound: fringes leave whole periods open."""
        size = "about {:.2g} px or more" if self.is_too_large else "{:.2g} px"
        if not self.linear:
            size = f"more than {self.largest_px:.2g} projector pixels"
        return _likelier(self.motion, size) if self.undecided else moved_device(self.motion, size)


def largest_bump_px(finest_period: float) -> float:
    """Return the largest bump, in px, that can be corrected with fringes of this period and longer ones."""
    return min(_LARGEST_CYCLES * finest_period, _LARGEST_PX)


def _likelier(motion: Floats, size: str) -> str:
    """Describe a motion (8,) that either device explains, the likelier device first.

    The motion of a camera is often attributed to both devices, that of a projector is not. A device counts as moved if
    its motion is at least half of the other's.
    """
    projector, camera = turns_px(motion)
    devices = ("camera", "projector") if camera >= HALF * projector else ("projector", "camera")
    return f"the {devices[0]}, or the {devices[1]}, moved by {size.format(max(projector, camera))}"


def between_periods_px(plan: SequencePlan, motion: MotionEstimate | None) -> float:
    """Return the smooth error left by an apparent motion between two periods or by jitter, as in
    `calib.refinement.Shifts`.

    In projector pixels; 0 if no such motion was found. An apparent motion between periods may not be a real one.
    """
    if motion is None or not motion.significant or motion.slow:
        return 0.0
    if motion.one_by_one:
        return _LEFT_OF_SINGLE_FRAMES * motion.size_px
    periods = sorted({fringe.period for fringe in plan.fringes}, reverse=True)
    for longer, shorter in pairwise(periods):
        before = [place for place in _places(plan, longer) if place >= motion.last / plan.repeats]
        after = [place for place in _places(plan, shorter) if place <= motion.first / plan.repeats]
        if not before and not after:
            # It is spread over cubic polynomials of either coordinate.
            return motion.size_px / (1 - (shorter / longer) ** 2) / sqrt(2 * CUBIC)
    return 0.0


def _places(plan: SequencePlan, period: float) -> list[int]:
    frames = {frame for fringe in plan.fringes if fringe.period == period for frame in fringe.frames}
    return [place for place, frame in enumerate(plan.shown) if frame in frames]


ADVICE = "Fasten what moved, let a projector warm up, keep away from the rig while it captures, and capture again."

MOTION_CORRECTED = FindingKind(
    "motion-corrected",
    "Camera or projector moved during the capture; it was corrected, and what remains is part of the sigmas.",
    ADVICE,
    ("frames", "size_px"),
)
MOVED = FindingKind(
    "moved",
    "Camera or projector moved during the capture, by more than can be corrected.",
    ADVICE,
    ("frames", "size_px"),
)
UNSEEN_MOTION = FindingKind(
    "unseen-motion",
    "All patterns along one axis came before those along the other, so the frames cannot show whether a device turned "
    "in between.",
    "Keep the border of the projector's picture in view, or show a fringe of the first axis again at the end.",
    ("suspected_px", "intrinsics_percent"),
)


@contextmanager
def attribute_to_motion(
    measured: Callable[[], MotionEstimate | None], phase_jump: Callable[[], tuple[int, int] | None]
) -> Iterator[None]:
    """Replace an InputError raised in the block by a RefusalError if motion explains it.

    The cause is either the motion returned by `measured`, if it explains most of the contradiction, or a bump between
    the two frames that `phase_jump` returns.
    """
    try:
        yield
    except InputError as error:
        motion = measured()
        # Exchanged frames contradict each other in ways that motion hardly explains.
        if motion is not None and motion.significant and motion.explained > AS_GOOD:
            raise moved(motion) from error
        if frames := phase_jump():
            raise RefusalError(
                MOVED,
                f"Camera or projector moved between frames {frames[0]} and {frames[1]}, by so much that "
                "the phase could not be unwrapped.",
                ADVICE,
                {"frames": frames},
            ) from error
        raise


@contextmanager
def attribute_to_shifts(plan: SequencePlan, shifts: Sequence[CodeShift]) -> Iterator[None]:
    """Replace an InputError raised in the block, for fringes that do not follow the codes, by a RefusalError if
    something moved between codes and fringes.
    """
    try:
        yield
    except InputError as error:
        if not shifts:
            raise
        raise _moved_before_fringes(plan, max(shifts, key=lambda shift: abs(shift.px))) from error


def refuse_period_slips(plan: SequencePlan, shifts: Sequence[CodeShift]) -> None:
    """Raise RefusalError if a device moved by whole fringe periods between codes and fringes.

    All coordinates then have the same period slip. It looks like a projector with another principal point, so that no
    consistency check can find it.
    """
    by_periods = [shift for shift in shifts if shift.by_periods]
    if by_periods:
        raise _moved_before_fringes(plan, max(by_periods, key=lambda shift: abs(shift.px)))


def refuse_unexplained_motion(plan: SequencePlan, anomalous: Set[int], motion: MotionEstimate | None) -> None:
    """Raise RefusalError if a motion is too large to be measured from fringes, and the `anomalous` frames belong to
    more than one fringe.

    Such a motion can make every pixel slip by the same number of periods when shorter fringes are unwrapped. An anomaly
    in a single fringe points to a bad frame instead, and is not refused.
    """
    broken = [fringe for fringe in plan.fringes if anomalous & {*fringe.frames}]
    if len(broken) > 1 and motion is not None and not (motion.linear or motion.significant):
        raise moved(motion)


def moved(motion: MotionEstimate) -> RefusalError:
    """Return the refusal of a capture that this motion has made unusable."""
    return RefusalError(
        MOVED,
        f"{capitalised(str(motion))}.",
        ADVICE,
        {"frames": (motion.first, motion.last), "size_px": motion.size_px},
    )


def _moved_before_fringes(plan: SequencePlan, shift: CodeShift) -> RefusalError:
    axes = (shift.axis,) if shift.sure else plan.axes
    codes = [frame for axis in axes for code in axis.codes for frame in code.frames]
    fringes = [frame for axis in axes for fringe in axis.fringes for frame in fringe.frames]
    # A small bump can look the same as one that is a whole period larger, and small bumps are more common.
    less = f", or whole periods of the fringes ({shift.axis.fringes[0].period:.3g} px) less" if shift.by_periods else ""
    size = f"about {abs(shift.px):.2g} projector pixels{less or ' or more'}"
    how_far = f": along {shift.axis.axis} by {size}," if shift.sure else ""
    return RefusalError(
        MOVED,
        f"Camera or projector moved{how_far} between {plan.name(min(codes))} and {plan.name(max(fringes))}, from the "
        "codes to the fringes.",
        ADVICE,
        {"frames": (min(codes), max(fringes)), "size_px": abs(shift.px)},
    )


def motion_findings(motion: MotionEstimate | None) -> tuple[Finding, ...]:
    """Return a warning for the operator about a motion that was corrected; nothing if there was none or it was too
    large.
    """
    if motion is None or not motion.significant or motion.is_too_large:
        return ()
    return (
        Finding(
            MOTION_CORRECTED,
            Severity.WARNING,
            f"{capitalised(str(motion))}; this was corrected, and the remaining uncertainty is part of the sigmas.",
            data={"frames": (motion.first, motion.last), "size_px": motion.size_px},
        ),
    )
