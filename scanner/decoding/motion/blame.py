"""What is said of captures during which something moved."""

from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager

from calib.refusal import RefusalError
from scanner.decoding.motion.code_shift import CodeShift
from scanner.decoding.motion.found import MotionFound
from scanner.decoding.sequence_plan import SequencePlan
from scanner.errors import InputError

ADVICE = "Fasten what moved, let a projector warm up, keep away from the rig while it captures, and capture again."
UNSEEN_MOTION = (
    "All patterns along one axis came before those along the other, so the frames cannot show whether a device "
    "turned in between"
)
# Frames that were exchanged contradict each other in ways that hardly any motion explains.
_EXPLAINED = 0.75


@contextmanager
def blaming_motion(
    found: Callable[[], MotionFound | None], broken: Callable[[], tuple[int, int] | None]
) -> Iterator[None]:
    """Frames that contradict each other in the block do so because of the motion that was found, if that explains it,
    or of a bump that has `broken` fringes between two frames.

    Raises RefusalError in the place of InputError.
    """
    try:
        yield
    except InputError as error:
        motion = found()
        if motion is not None and motion.significant and motion.explained > _EXPLAINED:
            raise moved(motion) from error
        if frames := broken():
            raise RefusalError(
                f"Camera or projector moved between frames {frames[0]} and {frames[1]}, by so much that "
                "the phase could not be unwrapped.",
                ADVICE,
            ) from error
        raise


@contextmanager
def blaming_shifts(plan: SequencePlan, shifts: Sequence[CodeShift]) -> Iterator[None]:
    """Fringes that do not follow the codes in the block do so because something moved between them, if it did.

    Raises RefusalError in the place of InputError.
    """
    try:
        yield
    except InputError as error:
        if not shifts:
            raise
        raise _moved_before_fringes(plan, max(shifts, key=lambda shift: abs(shift.px))) from error


def refuse_period_slips(plan: SequencePlan, shifts: Sequence[CodeShift]) -> None:
    """Raise RefusalError if something moved by whole periods between codes and fringes.

    All coordinates are then off by these: a projector with another principal point, which nothing contradicts.
    """
    by_periods = [shift for shift in shifts if shift.by_periods]
    if by_periods:
        raise _moved_before_fringes(plan, max(by_periods, key=lambda shift: abs(shift.px)))


def refuse_unexplained_motion(plan: SequencePlan, anomalous: Set[int], motion: MotionFound | None) -> None:
    """Raise RefusalError if something moved farther than fringes can tell, so that no motion explains what they show,
    and `anomalous` frames of several of them show it.

    Those by which shorter fringes are unwrapped may then name another cycle, the same one everywhere. What is wrong
    with a single fringe is a frame of it.
    """
    broken = [fringe for fringe in plan.fringes if anomalous & {*fringe.frames}]
    if len(broken) > 1 and motion is not None and not (motion.linear or motion.significant):
        raise moved(motion)


def moved(motion: MotionFound) -> RefusalError:
    """The refusal of a capture that this motion has spoilt."""
    return RefusalError(f"{_capital(motion)}.", ADVICE)


def _moved_before_fringes(plan: SequencePlan, shift: CodeShift) -> RefusalError:
    axes = (shift.axis,) if shift.sure else plan.axes
    codes = [frame for axis in axes for code in axis.codes for frame in code.frames]
    fringes = [frame for axis in axes for fringe in axis.fringes for frame in fringe.frames]
    # Small bumps, the usual ones, may look like the same and a whole period.
    less = f", or whole periods of the fringes ({shift.axis.fringes[0].period:.3g} px) less" if shift.by_periods else ""
    size = f"about {abs(shift.px):.2g} projector pixels{less or ' or more'}"
    how_far = f": along {shift.axis.axis} by {size}," if shift.sure else ""
    return RefusalError(
        f"Camera or projector moved{how_far} between {plan.name(min(codes))} and {plan.name(max(fringes))}, from the "
        "codes to the fringes.",
        ADVICE,
    )


def remarks_on(motion: MotionFound | None) -> tuple[str, ...]:
    """What a person should know of a motion that can be put up with."""
    if motion is None or not motion.significant or motion.is_too_large:
        return ()
    return (f"{_capital(motion)}; this was corrected, and the remaining uncertainty is part of the sigmas.",)


def _capital(motion: MotionFound) -> str:
    sentence = str(motion)
    return sentence[0].upper() + sentence[1:]
