"""Can one trust this thing? The answer in plain words, from the numbers."""

from collections.abc import Iterator

import numpy as np

from calib.finding import Finding, FindingKind, Severity, without_kinds
from calib.refusal import AMBIGUOUS
from scanner.objects.contents import SolvedObject
from scanner.quantities import shown_unit
from scanner.results import Verdict, fit_together
from scanner.rooms import LOOSE_STATIONS, lower_for_doubts

_ADVICE = (
    "Make its sides different, for example with painted spots or scraps of paper, so that the pictures show how it was "
    "turned; or turn it less between stations."
)

RESTING = FindingKind(
    "resting-surfaces",
    "Surfaces that did not move with a thing, as its background, are left out.",
    data=("resting_share",),
)


def verdict_on(solved: SolvedObject) -> Verdict:
    """The most serious finding decides."""
    names, findings = [station.name for station in solved.stations], tuple(_findings(solved))
    decisive = findings[0] if findings else None
    if decisive is not None and decisive.kind == AMBIGUOUS:
        headline = "The stations fit together in more than one way."
        return Verdict("refused", headline, (decisive.message,), decisive.advice, findings, (AMBIGUOUS,))
    reasons, kinds = tuple(_reasons(solved)), tuple(finding.kind for finding in findings)
    if decisive is not None and decisive.kind == LOOSE_STATIONS:
        return Verdict("refused", decisive.message, reasons, decisive.advice, findings, kinds)
    together = fit_together(len(names), len(names) + len(solved.outlier_stations), "object")
    of_all = Verdict("good", f"{together}.", reasons, findings=findings, kinds=kinds)
    return lower_for_doubts(of_all, together, solved.calibration, solved.outlier_stations)


def _findings(solved: SolvedObject) -> Iterator[Finding]:
    """The most serious first."""
    if solved.alternatives:
        doubtful = sorted({alternative.view for alternative in solved.alternatives})
        of_capture = {station.number: station.name for station in solved.stations}
        best = max(solved.alternatives, key=lambda alternative: alternative.worth)
        yield Finding(
            AMBIGUOUS,
            Severity.REFUSAL,
            f"The rotation of {', '.join(of_capture[k] for k in doubtful)} is ambiguous, for example by "
            f"{best.turn_deg:.0f}°: the thing looks the same from several sides, as balls do.",
            _ADVICE,
            {"turn_deg": float(best.turn_deg)},
        )
    if solved.loose:
        free = ", ".join(solved.stations[n].name for n in solved.loose)
        message = f"{free} can turn or slide on the surface of the others."
        yield Finding(LOOSE_STATIONS, Severity.REFUSAL, message, _ADVICE)
    if solved.rests > 0:
        message = f"{solved.rests:.0%} of the visible surfaces did not move with the thing, and are left out."
        yield Finding(RESTING, Severity.NOTE, message, data={"resting_share": float(solved.rests)})
    yield from (outlier.warning for outlier in solved.outlier_stations)
    yield from solved.findings


def _reasons(solved: SolvedObject) -> Iterator[str]:
    unit = shown_unit(solved.unit)
    later = solved.stations[1:]
    worst = max(float(np.linalg.norm(station.sigma)) for station in later)
    turned = max(float(np.linalg.norm(station.sigma_deg)) for station in later)
    yield f"Each station's pose relative to the thing is known to ± {unit.error(worst)} and ± {turned:.2g}°, or better."
    if solved.turntable is not None:
        yield f"It was turned about one axis, by {_turns(solved.turntable.angles_deg)}: a turntable."
    residual = float(np.median(list(solved.residual.values())))
    pairs = "1 pair of stations" if len(solved.residual) == 1 else f"{len(solved.residual)} pairs of stations"
    yield f"{pairs} share surfaces, which are {unit.error(residual)} apart, noise included."
    yield from map(str, without_kinds(_findings(solved), AMBIGUOUS, LOOSE_STATIONS))


def _turns(angles_deg: np.ndarray) -> str:
    steps = np.abs(np.diff(np.unwrap(angles_deg, period=360.0)))
    return f"{steps.min():.2f} to {steps.max():.2f}° from one to the next"
