"""Error messages and warnings for captures during which something moved."""

from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager

from calib.finding import Finding, FindingKind, Severity
from calib.refusal import RefusalError
from scanner.decoding.motion.code_shift import CodeShift
from scanner.decoding.motion.device_motion import MotionEstimate
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import AS_GOOD
from scanner.errors import InputError
from scanner.shown_text import capitalised

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
