"""What detectors tell of a motion of camera or projector during a capture: its course, its size, and the verdict on it.

Shifts that grow as the period shortens look like a motion between two periods: where software resamples frames by a
fraction of a pixel, linear interpolation shifts long waves correctly, but short ones lag behind with the square of
their frequency. The fringes of one period then disagree with those of the next, smoothly over whole surfaces, as if a
device had been knocked exactly between them. The two causes cannot be distinguished.
"""

from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from math import inf, sqrt

from calib.estimation import Shifts
from calib.finding import Finding, FindingKind, Severity
from calib.numerics import CUBIC, Floats
from calib.refusal import RefusalError
from scanner.decoding.motion.rigid_motion import CoordinateShift, moved_device, turns_px
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import AS_GOOD, FEW, HALF
from scanner.errors import InputError
from scanner.shown_text import capitalised

# Least size of a motion, which interreflection, ripple and noise do not reach at rest.
LEAST_PX = 0.02
# Largest correction without confirmation: of a motion between the axes, or one that explains little.
_LARGEST_BUMP_PX = 0.35
# Share of the shortest period. Sizes can be measured up to a sixth of it, but a bump within a fringe also leaves a
# ripple of up to a quarter of itself in single matches.
_LARGEST_CYCLES = 1 / 8
# Each fringe sees only a part of a drift. A larger one shifts coordinates beyond the linear range of their gradient.
_LARGEST_PX = 3.0
# For independent frames: half a radian of a fringe of six pixels, beyond which it is no longer linear.
_LARGEST_OF_FRAMES_PX = 0.5
# Standard deviation assumed for an unobservable motion between the axes.
SUSPECTED_PX = 0.3
# Jitter of single frames ripples a fringe. The part that is alike over whole surfaces is this share of the motion:
# 0.001 to 0.002 px of 0.2 to 0.3, for each polynomial, in three simulated rooms.
_LEFT_OF_SINGLE_FRAMES = 0.006

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


class MotionCourse(Enum):
    """How a motion went on in time."""

    BUMP = "at once, between two frames"
    DRIFT = "evenly, over many frames"
    FRAME_BY_FRAME = "each frame on its own"

    def largest_px(self, finest_period: float, explained: float) -> float:
        """Return the size up to which fringes of this period and longer ones correct a motion.

        Drifts explain 80 to 90 % of the contradiction of rest. One that explains a third is a bump of many px.
        """
        if self is MotionCourse.FRAME_BY_FRAME:
            return _LARGEST_OF_FRAMES_PX
        largest_px = _LARGEST_PX if self is MotionCourse.DRIFT else largest_bump_px(finest_period)
        return min(largest_px, _LARGEST_BUMP_PX) if explained < HALF else largest_px


class MotionVerdict(Enum):
    """What follows from a motion."""

    NONE = "it does not exceed what is measured at rest"
    CORRECTABLE = "its effect is subtracted from the coordinates"
    TOO_LARGE = "no match can be trusted"

    @classmethod
    def of(cls, size_px: float, largest_px: float, *, significant: bool) -> "MotionVerdict":
        """Return the verdict on a motion of a size, of which as much as `largest_px` is corrected."""
        if not significant:
            return cls.NONE
        return cls.TOO_LARGE if size_px > largest_px else cls.CORRECTABLE


def largest_bump_px(finest_period: float) -> float:
    """Return the largest bump, in px, that can be corrected with fringes of this period and longer ones."""
    return min(_LARGEST_CYCLES * finest_period, _LARGEST_PX)


@dataclass(frozen=True)
class DetectedMotion:
    """A motion of camera or projector, as every detector returns it."""

    first: int
    """The frame before a bump, or the first of a drift."""
    last: int
    """The frame after a bump, or the last of a drift."""
    size_px: float | None
    """How far it moved the coordinates; None if that is unknown."""

    def __str__(self) -> str:
        """Describe a motion of which no more is known."""
        return (
            f"camera or projector moved between frames {self.first} and {self.last}, by so much that the phase could "
            "not be unwrapped"
        )


@dataclass(frozen=True)
class CodeShift(DetectedMotion):
    """Motion along an axis between the frames of its codes and those of its fringes.

    Its size is known only up to whole periods, and a part of the motion if that happened during either group of frames.
    """

    axis: AxisPlan
    """Along which."""
    size_px: float
    """In projector pixels, of either sign."""
    between: str
    """The names of the frames."""
    by_periods: bool = False
    """Whether it includes whole periods of the longest fringe, which leave all pixels decodable."""
    is_sure: bool = True
    """Whether the motion was along this axis, rather than along the other one alone, by another amount."""

    def __str__(self) -> str:
        """Describe the motion. A small bump can look the same as one that is a whole period larger, and is commoner."""
        period = self.axis.fringes[0].period
        less = f", or whole periods of the fringes ({period:.3g} px) less" if self.by_periods else " or more"
        size = f": along {self.axis.axis} by about {abs(self.size_px):.2g} projector pixels{less},"
        return f"camera or projector moved{size if self.is_sure else ''} {self.between}, from the codes to the fringes"


@dataclass(frozen=True)
class MotionEstimate(DetectedMotion):
    """The motion of both devices that best explains the frames of a capture."""

    size_px: float
    """How far it moved the coordinates."""
    motion: Floats
    """(8,): as in `rigid_motion`; the root mean square if each frame moved by itself."""
    course: MotionCourse
    """How it went on in time."""
    verdict: MotionVerdict
    """What follows from it."""
    explained: float
    """The share it explains of the contradiction of rest."""
    shift: CoordinateShift
    """Of x and y against each other; of the means over the fringes if each frame moved by itself."""
    alternatives: tuple[CoordinateShift, ...]
    """The shifts by other trajectories that fit about as well."""
    unseen: tuple[CoordinateShift, ...] = ()
    """Possible undetected shifts, one standard deviation each."""
    turn_sigma_px: float = 0.0
    """Largest standard deviation of a turn of a device between the axes."""
    measurable_px: float = inf
    """A motion of this size or more may be larger by any amount."""
    largest_px: float = _LARGEST_BUMP_PX
    """The largest bump that is corrected."""
    is_either_device: bool = False
    """Whether the other device alone may have moved instead."""

    @property
    def is_significant(self) -> bool:
        """Whether it exceeds what is measured at rest."""
        return self.verdict is not MotionVerdict.NONE

    @property
    def is_measured(self) -> bool:
        """Whether it is small enough for its size to be measured."""
        return self.size_px < self.measurable_px

    @property
    def is_blind(self) -> bool:
        """Whether the frames cannot show a turn of a device between the axes."""
        return self.turn_sigma_px > SUSPECTED_PX / 2

    @property
    def shifts(self) -> Shifts:
        """Return the shifts that may remain in the matches after the correction."""
        likely = []
        if self.is_significant:
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
        if self.course is MotionCourse.FRAME_BY_FRAME:
            return f"the camera's frames are each somewhere else, by {turns_px(self.motion)[1]:.2g} px"
        when = "slowly, from frame {} to {}" if self.course is MotionCourse.DRIFT else "between frames {} and {}"
        return f"{self._description()} {when.format(self.first, self.last)}"

    def _description(self) -> str:
        """Describe which device moved, and how far. A large size is a lower bound: fringes leave whole periods open."""
        size = "about {:.2g} px or more" if self.verdict is MotionVerdict.TOO_LARGE else "{:.2g} px"
        if not self.is_measured:
            size = f"more than {self.largest_px:.2g} projector pixels"
        if not self.is_either_device:
            return moved_device(self.motion, size)
        # The motion of a camera is often attributed to both devices, that of a projector is not.
        projector, camera = turns_px(self.motion)
        devices = ("camera", "projector") if camera >= HALF * projector else ("projector", "camera")
        return f"the {devices[0]}, or the {devices[1]}, moved by {size.format(max(projector, camera))}"


def between_periods_px(plan: SequencePlan, motion: MotionEstimate | None) -> float:
    """Return the smooth error left by an apparent motion between two periods or by jitter, as in
    `calib.refinement.Shifts`.

    In projector pixels; 0 if no such motion was found. An apparent motion between periods may not be a real one.
    """
    if motion is None or not motion.is_significant or motion.course is MotionCourse.DRIFT:
        return 0.0
    if motion.course is MotionCourse.FRAME_BY_FRAME:
        return _LEFT_OF_SINGLE_FRAMES * motion.size_px
    first, last = motion.first / plan.repeats, motion.last / plan.repeats
    periods = sorted({fringe.period for fringe in plan.fringes}, reverse=True)
    for longer, shorter in pairwise(periods):
        if max(_places(plan, longer)) < last and min(_places(plan, shorter)) > first:
            # It is spread over cubic polynomials of either coordinate.
            return motion.size_px / (1 - (shorter / longer) ** 2) / sqrt(2 * CUBIC)
    return 0.0


def _places(plan: SequencePlan, period: float) -> list[int]:
    frames = {frame for fringe in plan.fringes if fringe.period == period for frame in fringe.frames}
    return [place for place, frame in enumerate(plan.shown) if frame in frames]


@contextmanager
def attribute_to_motion(
    measured: Callable[[], MotionEstimate | None], phase_jump: Callable[[], DetectedMotion | None]
) -> Iterator[None]:
    """Replace an InputError raised in the block by a RefusalError if motion explains it.

    The cause is either the motion returned by `measured`, if it explains most of the contradiction, or that of
    `phase_jump`.
    """
    try:
        yield
    except InputError as error:
        motion = measured()
        # Exchanged frames contradict each other in ways that motion hardly explains.
        if motion is not None and motion.is_significant and motion.explained > AS_GOOD:
            raise moved(motion) from error
        if jump := phase_jump():
            raise moved(jump) from error
        raise


@contextmanager
def attribute_to_shifts(shifts: Sequence[CodeShift]) -> Iterator[None]:
    """Replace an InputError raised in the block, for fringes that do not follow the codes, by a RefusalError if
    something moved between codes and fringes.
    """
    try:
        yield
    except InputError as error:
        if not shifts:
            raise
        raise moved(_largest(shifts)) from error


def refuse_period_slips(shifts: Sequence[CodeShift]) -> None:
    """Raise RefusalError if a device moved by whole fringe periods between codes and fringes.

    All coordinates then have the same period slip. It looks like a projector with another principal point, so that no
    consistency check can find it.
    """
    if by_periods := [shift for shift in shifts if shift.by_periods]:
        raise moved(_largest(by_periods))


def _largest(shifts: Sequence[CodeShift]) -> CodeShift:
    return max(shifts, key=lambda shift: abs(shift.size_px))


def refuse_unexplained_motion(plan: SequencePlan, anomalous: Set[int], motion: MotionEstimate | None) -> None:
    """Raise RefusalError if a motion is too large to be measured from fringes, and the `anomalous` frames belong to
    more than one fringe.

    Such a motion can make every pixel slip by the same number of periods when shorter fringes are unwrapped. An anomaly
    in a single fringe points to a bad frame instead, and is not refused.
    """
    broken = [fringe for fringe in plan.fringes if anomalous & {*fringe.frames}]
    if len(broken) > 1 and motion is not None and not (motion.is_measured or motion.is_significant):
        raise moved(motion)


def moved(motion: DetectedMotion) -> RefusalError:
    """Return the refusal of a capture that this motion has made unusable."""
    size = {} if motion.size_px is None else {"size_px": abs(motion.size_px)}
    return RefusalError(MOVED, f"{capitalised(str(motion))}.", ADVICE, {"frames": (motion.first, motion.last), **size})


def motion_findings(motion: MotionEstimate | None) -> tuple[Finding, ...]:
    """Return a warning for the operator about a motion that was corrected; nothing if there was none."""
    if motion is None or motion.verdict is not MotionVerdict.CORRECTABLE:
        return ()
    return (
        Finding(
            MOTION_CORRECTED,
            Severity.WARNING,
            f"{capitalised(str(motion))}; this was corrected, and the remaining uncertainty is part of the sigmas.",
            data={"frames": (motion.first, motion.last), "size_px": motion.size_px},
        ),
    )
