"""Captures during which something moved: refused, or with what may be left of it in their sigmas and findings."""

from collections.abc import Sequence
from dataclasses import replace

from calib.estimation import Shifts
from calib.finding import Finding, FindingKind, Severity
from calib.self_calibration import SelfCalibration
from scanner.decoding import SUSPECTED_PX, UNSEEN_MOTION, moved
from scanner.results import Decoded

# Largest effect of a remaining motion on the intrinsics, one standard deviation; or as much as their uncertainty at
# rest.
_MOST_PERCENT = 0.5

REMAINING_MOTION = FindingKind(
    "remaining-motion",
    "A motion was corrected, and what may remain of it matters for the intrinsics; it is part of their sigmas.",
    "Fasten what moved, and capture again.",
    ("intrinsics_percent", "at_rest_percent"),
)


def refuse_moved(capture: Decoded) -> None:
    """Raise RefusalError if something moved so far during a capture that its matches cannot be trusted."""
    motion = capture.decoding.motion if capture.decoding else None
    if motion is not None and motion.is_too_large:
        raise moved(motion)


def refuse_costly(captures: Sequence[Decoded], solution: SelfCalibration) -> None:
    """Raise RefusalError for the capture with the largest motion, if its effect on the solution is too large."""
    if solution.likely_percent > max(_MOST_PERCENT, solution.at_rest_percent):
        motions = [capture.decoding.motion for capture in captures if capture.decoding and capture.decoding.motion]
        raise moved(max(motions, key=lambda motion: motion.size_px))


def shifts_of(capture: Decoded) -> Shifts:
    """Return the shifts that all matches of a capture may have in common."""
    motion = capture.decoding.motion if capture.decoding else None
    of_motion = Shifts() if motion is None else motion.shifts
    of_panel = capture.panel.shifts if capture.panel else ()
    of_decoding = capture.decoding.shifts if capture.decoding else ()
    return replace(of_motion, decoding=(*of_panel, *of_decoding), smooth_px=capture.origin.smooth_px)


def with_motion_findings(captures: Sequence[Decoded], solution: SelfCalibration) -> SelfCalibration:
    """Add findings on the loss of accuracy by motion, and on motion that the capture cannot reveal, where either
    applies.
    """
    if solution.likely_percent > _MOST_PERCENT:
        cost = Finding(
            REMAINING_MOTION,
            Severity.NOTE,
            f"The remaining motion may change the intrinsics by {solution.likely_percent:.2g} %; at rest, this view "
            f"determines them to {solution.at_rest_percent:.2g} %. Both are part of their sigmas.",
            data={"intrinsics_percent": solution.likely_percent, "at_rest_percent": solution.at_rest_percent},
        )
        solution = replace(solution, findings=(*solution.findings, cost))
    motions = [capture.decoding.motion for capture in captures if capture.decoding]
    if not any(motion is not None and motion.blind for motion in motions):
        return solution
    unseen = Finding(
        UNSEEN_MOTION,
        Severity.NOTE,
        "All patterns along one axis came before those along the other, so the frames cannot show whether a device "
        f"turned in between: {SUSPECTED_PX:g} px would change the intrinsics by {solution.possible_percent:.2g} %, "
        "which is part of their sigmas; a larger motion is not.",
        UNSEEN_MOTION.remedy,
        {"suspected_px": SUSPECTED_PX, "intrinsics_percent": solution.possible_percent},
    )
    return replace(solution, findings=(*solution.findings, unseen))
