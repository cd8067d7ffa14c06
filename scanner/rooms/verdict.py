"""Can one trust this room? The answer in plain words, from the numbers."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity, of_kinds
from calib.geometry import Calibration
from calib.refusal import AMBIGUOUS
from calib.scene import BY_SCENE, CALIBRATION_CHANGED
from scanner.quantities import shown_unit
from scanner.results import Verdict, fit_together
from scanner.rooms.contents import OutlierStation, SolvedRoom
from scanner.rooms.scene_rig import weakness_of

# Each station then has less weight, because its smooth errors are common to all.
_MOST_ALIKE = 2.0

_MORE_THAN_ONE_WAY = "The stations fit together in more than one way."

LOOSE_STATIONS = FindingKind(
    "loose-stations",
    "Stations can slide or turn in the room, or on the surface of a thing: what they share does not hold them.",
    "Add a station between these and the others, from which something other than one wall is seen by both; make the "
    "sides of a thing different.",
)
UNMODELLED_DISTORTION = FindingKind(
    "unmodelled-distortion",
    "Smooth errors are the same at all stations: the lenses have distortion that is not modelled.",
    "Calibrate the rig with a printed board (scan board), which estimates the pixels' aspect, too, and give its result "
    "with --calibration.",
    ("alike_ratio",),
)


def verdict_on(room: SolvedRoom) -> Verdict:
    """The most serious finding decides."""
    names, findings = [station.name for station in room.stations], tuple(_findings(room))
    decisive = findings[0] if findings else None
    together = fit_together(len(names), len(names) + len(room.outlier_stations), "room")
    if decisive is not None and decisive.kind == AMBIGUOUS:
        both = "Both are in room.yaml; cloud, mesh and plan are of the likelier one."
        answers = _likelihood(room), both
        return Verdict("refused", _MORE_THAN_ONE_WAY, answers, decisive.advice, findings, (AMBIGUOUS,))
    reasons = tuple(_reasons(room))
    kinds = tuple(finding.kind for finding in findings if finding.kind != UNMODELLED_DISTORTION)
    if decisive is not None and decisive.kind == LOOSE_STATIONS:
        return Verdict("fair", f"{together}, but {decisive.message}", reasons, decisive.advice, findings, kinds)
    if decisive is not None and decisive.kind == UNMODELLED_DISTORTION:
        headline = f"{together}, but the lenses have distortion that is not modelled."
        reasons = (decisive.message, *reasons)
        return Verdict("fair", headline, reasons, decisive.advice, findings, (*kinds, UNMODELLED_DISTORTION))
    of_all = Verdict("good", f"{together}.", reasons, findings=findings, kinds=kinds)
    return lower_for_doubts(of_all, together, room.calibration, room.outlier_stations)


def lower_for_doubts(
    of_all: Verdict, together: str, calibration: Calibration, outliers: Sequence[OutlierStation]
) -> Verdict:
    """The verdict on stations that fit `together`, fair if their rig is doubtful, or some are left out."""
    if changed := of_kinds(of_all.findings, CALIBRATION_CHANGED):
        headline = f"{together}, but with a calibration that no longer holds."
        return replace(of_all, grade="fair", headline=headline, advice=changed[0].advice)
    if weakness := weakness_of(calibration, of_all.findings):
        return replace(of_all, grade="fair", headline=f"{together}, but {weakness}", advice=BY_SCENE.remedy)
    if outliers:
        names = ", ".join(station.name for station in outliers)
        return replace(of_all, grade="fair", headline=f"{together}; left out: {names}.")
    return of_all


def _findings(room: SolvedRoom) -> Iterator[Finding]:
    """The most serious first."""
    names = [station.name for station in room.stations]
    if room.group.ambiguous:
        yield Finding(
            AMBIGUOUS,
            Severity.REFUSAL,
            f"{_MORE_THAN_ONE_WAY} {_likelihood(room)}",
            "Put something into the room that makes its sides different, such as a box on the floor, and scan again; "
            "or add a station between two others.",
            {"times_less_likely": _times_less_likely(room)},
        )
    if loose := sorted({names[undetermined.station] for undetermined in room.estimate.undetermined}):
        yield Finding(
            LOOSE_STATIONS,
            Severity.WARNING,
            f"{', '.join(loose)} can slide or turn in it.",
            "Add a station between these and the others, from which something other than one wall is seen by both.",
        )
    if room.estimate.levels.alike > _MOST_ALIKE:
        yield Finding(
            UNMODELLED_DISTORTION,
            Severity.WARNING,
            "Smooth errors are the same at all stations, so lengths may err by more than their sigmas.",
            UNMODELLED_DISTORTION.remedy,
            {"alike_ratio": room.estimate.levels.alike},
        )
    yield from (outlier.warning for outlier in room.outlier_stations)
    yield from room.findings


def _times_less_likely(room: SolvedRoom) -> float:
    return float(np.exp(min(alternative.behind_nats for alternative in room.group.alternatives)))


def _likelihood(room: SolvedRoom) -> str:
    return (
        f"Another arrangement of the stations is only {_times_less_likely(room):.3g} times less likely: the room looks "
        "the same from different places, or too little of it was seen."
    )


def _reasons(room: SolvedRoom) -> Iterator[str]:
    unit = shown_unit(room.unit)
    later = room.stations[1:]
    if later:
        worst = float(np.nanmax([np.linalg.norm(station.sigma) for station in later]))
        turned = float(np.nanmax([np.linalg.norm(station.sigma_deg) for station in later]))
        yield f"Each station's pose is known to ± {unit.error(worst)} and ± {turned:.2g}°, or better."
    if np.isfinite(room.group.ahead_nats):
        factor = np.exp(room.group.ahead_nats)
        yield f"Any other arrangement of the stations is less likely by a factor of {factor:.0e}."
    pairs = [pair for pair in room.pairs if {pair.first, pair.second} <= set(room.group.stations)]
    if pairs:
        weakest = min(pairs, key=lambda pair: pair.overlap)
        shared = "1 pair of stations shares" if len(pairs) == 1 else f"{len(pairs)} pairs of stations share"
        names = f"{room.names[weakest.first]} and {room.names[weakest.second]}"
        yield f"{shared} surfaces; the least, {names}, {weakest.overlap:.0%} of what they saw."
    residuals = np.array([station.residual_px for station in room.stations])
    if np.isfinite(residuals).any():
        residual = np.sqrt(np.nanmean(residuals**2))
        yield f"With planes shared by all stations, cells of matches are off by {residual:.3f} projector px."
    yield from (outlier.warning.message for outlier in room.outlier_stations)
    yield from map(str, room.findings)
