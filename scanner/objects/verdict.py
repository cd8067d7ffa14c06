"""Can one trust this thing? The answer in plain words, from the numbers."""

from collections.abc import Iterator

import numpy as np

from scanner.objects.contents import SolvedObject
from scanner.quantities import shown_unit
from scanner.results import Verdict

_ADVICE = (
    "Make its sides different, for example with painted spots or scraps of paper, so that the pictures show how it was "
    "turned; or turn it less between stations."
)


def verdict_on(solved: SolvedObject) -> Verdict:
    """The most serious finding decides."""
    names = [station.name for station in solved.stations]
    if solved.alternatives:
        doubtful = sorted({alternative.view for alternative in solved.alternatives})
        of_capture = {station.number: station.name for station in solved.stations}
        best = max(solved.alternatives, key=lambda alternative: alternative.worth)
        return Verdict(
            "refused",
            "The stations fit together in more than one way.",
            (
                f"The rotation of {', '.join(of_capture[k] for k in doubtful)} is ambiguous, for example by "
                f"{best.turn_deg:.0f}°: the thing looks the same from several sides, as balls do.",
            ),
            _ADVICE,
        )
    if solved.loose:
        free = ", ".join(names[n] for n in solved.loose)
        return Verdict(
            "refused", f"{free} can turn or slide on the surface of the others.", tuple(_reasons(solved)), _ADVICE
        )
    if solved.outlier_stations:
        outliers = ", ".join(station.name for station in solved.outlier_stations)
        return Verdict("fair", f"{len(names)} stations are one thing; left out: {outliers}.", tuple(_reasons(solved)))
    return Verdict(
        "good",
        f"{len(names)} stations are one thing, and the others determine the pose of each.",
        tuple(_reasons(solved)),
    )


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
    if solved.rests > 0:
        yield f"{solved.rests:.0%} of the visible surfaces did not move with the thing, and are left out."
    for each in solved.outlier_stations:
        yield f"{each.name} is left out: {each.reason}."


def _turns(angles_deg: np.ndarray) -> str:
    steps = np.abs(np.diff(np.unwrap(angles_deg, period=360.0)))
    return f"{steps.min():.2f} to {steps.max():.2f}° from one to the next"
