"""A network from stations of anything rigid, where no corner is: its pairs one by one, then all devices together."""

from collections.abc import Mapping, Sequence

from calib.finding import Finding, FindingKind, Severity
from calib.networks import NetworkEstimate, estimate_from_pairs
from calib.refinement import KnownRig, LensPrior
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint
from scanner.configuration import Config
from scanner.networks.captures import Captures, Pair, refuse_too_few
from scanner.networks.sights import in_light
from scanner.objects import rig_from_object
from scanner.results import Decoded
from scanner.ui import SILENT, Progress

NETWORK_BY_SCENE = FindingKind(
    "network-by-scene",
    "A network was calibrated by what its stations share, without a corner.",
    "For smaller sigmas take more stations, turned about different axes by 10 to 30° each.",
    ("captures", "focal_percent"),
)
PAIR_FOLLOWS = FindingKind(
    "pair-follows",
    "A pair of a network is not calibrated by its own stations; its devices follow by the light that they share.",
    "Let more of a pattern be in the picture of both, and turn less from one station to the next.",
)


def calibrate_by_scene(
    captures: Captures,
    config: Config,
    progress: Progress,
    *,
    lenses: Mapping[str, LensPrior],
    points: Mapping[str, PrincipalPoint],
) -> tuple[NetworkEstimate, tuple[Finding, ...]]:
    """All devices from three stations or more, and what is worth knowing of it.

    Raises RefusalError if no pair is calibrated by what its stations share, or a device does not connect.
    """
    count = len(captures.stations)
    refuse_too_few(count)
    configs = {} if config.rigs is None else config.pairs
    rigs: dict[Pair, KnownRig] = {}
    refusals: dict[Pair, RefusalError] = {}
    for pair in captures.decoded:
        stations = [station[pair] for station in captures.stations]
        with progress.step(f"Calibrating {in_light(*pair)}"):
            try:
                rigs[pair] = known_rig(stations, configs.get(pair, config))
            except RefusalError as refusal:
                refusals[pair] = refusal
    if not rigs:
        pair, first = next(iter(refusals.items()))
        raise RefusalError(first.finding.kind, f"{in_light(*pair)}: {first.reason}", first.advice, first.finding.data)
    with progress.step("Calibrating all devices together"):
        estimate = estimate_from_pairs(
            [{pair: capture.matches for pair, capture in station.items()} for station in captures.stations],
            rigs,
            captures.sizes,
            lenses=lenses,
            points=points,
        )
    sigma = max(float(estimate.sigmas(name)[0]) for name in estimate.names)
    how = Finding(
        NETWORK_BY_SCENE,
        Severity.NOTE,
        f"Calibrated without a corner, by what {count} stations share.",
        data={"captures": float(count), "focal_percent": 100 * sigma},
    )
    return estimate, (how, *(_follows(*item) for item in refusals.items()))


def known_rig(stations: Sequence[Decoded], config: Config) -> KnownRig:
    """A pair by what its stations share. Raises RefusalError."""
    start = rig_from_object(stations, config, SILENT)
    assert start.uncertainty is not None
    return KnownRig(start.uncertainty.rig, start.uncertainty.covariance)


def _follows(pair: Pair, refusal: RefusalError) -> Finding:
    message = f"{in_light(*pair)} is not calibrated by itself, and follows the others: {refusal.reason}"
    return Finding(PAIR_FOLLOWS, Severity.NOTE, message, refusal.advice)
