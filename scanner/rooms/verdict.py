"""Can one trust this room? The answer in plain words, from the numbers."""

from collections.abc import Iterator

import numpy as np

from scanner.quantities import shown_unit
from scanner.results import Verdict
from scanner.rooms.contents import SolvedRoom

# Each station then has less weight, because its smooth errors are common to all.
_MOST_ALIKE = 2.0

AMBIGUOUS = "The stations fit together in more than one way"


def verdict_on(room: SolvedRoom) -> Verdict:
    """The most serious finding decides."""
    names = [station.name for station in room.stations]
    if room.group.ambiguous:
        behind = min(alternative.behind_nats for alternative in room.group.alternatives)
        return Verdict(
            "refused",
            f"{AMBIGUOUS}.",
            (
                f"Another arrangement of the stations is only {np.exp(behind):.3g} times less likely: the room looks "
                "the same from different places, or too little of it was seen.",
                "Both are in room.yaml; cloud, mesh and plan are of the likelier one.",
            ),
            "Put something into the room that makes its sides different, such as a box on the floor, and scan again; "
            "or add a station between two others.",
        )
    reasons = tuple(_reasons(room))
    loose = sorted({names[direction.station] for direction in room.estimate.undetermined})
    if loose:
        return Verdict(
            "fair",
            f"{len(names)} stations are one room, but {', '.join(loose)} can slide or turn in it.",
            reasons,
            "Add a station between these and the others, from which something other than one wall is seen by both.",
        )
    if room.estimate.levels.alike > _MOST_ALIKE:
        return Verdict(
            "fair",
            f"{len(names)} stations are one room, but the lenses have distortion that is not modelled.",
            ("Smooth errors are the same at all stations, so lengths may err by more than their sigmas.", *reasons),
            "Calibrate the rig with a printed board (scan board), which estimates the pixels' aspect, too, and give "
            "its result with --calibration.",
        )
    if room.outlier_stations:
        outliers = ", ".join(station.name for station in room.outlier_stations)
        return Verdict("fair", f"{len(names)} stations are one room; left out: {outliers}.", reasons)
    return Verdict("good", f"{len(names)} stations are one room, and the others determine the pose of each.", reasons)


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
    for outlier in room.outlier_stations:
        yield f"{outlier.name} is left out: {outlier.reason}."
    yield from room.remarks
