"""Captures of pairs → one estimate of all devices, and one cloud from all rays.

A network from stations of anything rigid, where no corner is: its pairs one by one, then all devices together.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.networks import Joined, NetworkEstimate, estimate_from_pairs, estimate_network, joined
from calib.refinement import KnownRig, LensPrior
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.networks.captures import Captures, Pair, refuse_too_few
from scanner.networks.sights import in_light
from scanner.objects import rig_from_object
from scanner.quantities import UNKNOWN_UNIT, parse_length
from scanner.reconstruction import lenses_by_name, shifts_of
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
_METRES = "m"


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


@dataclass(frozen=True, eq=False)
class SolvedNetwork:
    """All devices, and what they measured."""

    captures: Captures
    estimate: NetworkEstimate
    surfaces: Mapping[str, Joined]
    """Of each projector's light; of several stations at the first."""
    factor: float
    """The length of the estimate's unit in `unit`."""
    unit: str
    known: tuple[str, str] | None = None
    """Devices whose distance gives the scale."""
    further: tuple[Mapping[str, Joined], ...] = ()
    """The surfaces at further stations."""
    findings: tuple[Finding, ...] = ()
    """What is worth knowing of the estimate."""

    @property
    def stations(self) -> tuple[Mapping[str, Joined], ...]:
        """The surfaces at all stations."""
        return (self.surfaces, *self.further)


@dataclass(frozen=True)
class KnownDistance:
    """Between two devices, in metres."""

    first: str
    second: str
    length_m: float

    @classmethod
    def parse(cls, text: str) -> "KnownDistance":
        """As in left,stage,2.35m. Raises InputError."""
        parts = text.split(",")
        if len(parts) != 3:
            raise InputError(f"--distance: expected two devices and a length, as in left,stage,2.35m, found '{text}'")
        return cls(parts[0], parts[1], parse_length(parts[2], _METRES))


def refuse_unknown(known: KnownDistance | None, devices: Collection[str]) -> None:
    """Raises InputError for devices that are none of these."""
    for name in (known.first, known.second) if known else ():
        if name not in devices:
            raise InputError(f"--distance: no device is called '{name}'; there are {', '.join(sorted(devices))}")
    if known and known.first == known.second:
        raise InputError(f"--distance: {known.first} is given twice; a distance is between two devices")


def solve_network(captures: Captures, known: KnownDistance | None, config: Config, progress: Progress) -> SolvedNetwork:
    """Raises RefusalError if neither a corner nor what stations share calibrates a pair, or a device does not connect;
    InputError.
    """
    cameras, projectors = ({pair[role]: captures.sizes[pair[role]] for pair in captures.decoded} for role in (0, 1))
    points = {name: config.of_device(name).principal_point(size) for name, size in cameras.items()}
    lenses = lenses_by_name(config, cameras, projectors)
    findings: tuple[Finding, ...] = ()
    if captures.further:
        estimate, findings = calibrate_by_scene(captures, config, progress, lenses=lenses, points=points)
    else:
        with progress.step("Calibrating all devices together"):
            estimate = estimate_network(
                {pair: capture.matches for pair, capture in captures.decoded.items()},
                captures.sizes,
                squareness_deg=config.corner.expected_squareness_deg,
                lenses=lenses,
                points=points,
                shifts={pair: shifts_of(capture) for pair, capture in captures.decoded.items()},
            )
    factor, unit = 1.0, UNKNOWN_UNIT
    if known is not None:
        ends = [estimate.device(name).pose.translation for name in (known.first, known.second)]
        factor, unit = known.length_m / float(np.linalg.norm(ends[1] - ends[0])), _METRES
    with progress.step("Joining the cameras' surfaces"):
        surfaces, *further = (_surfaces_of(estimate, station) for station in captures.stations)
    ends_known = None if known is None else (known.first, known.second)
    return SolvedNetwork(captures, estimate, surfaces, factor, unit, ends_known, tuple(further), findings)


def _surfaces_of(estimate: NetworkEstimate, station: Mapping[Pair, Decoded]) -> dict[str, Joined]:
    """Of each projector's light."""
    return {
        projector: joined(
            estimate, projector, {c: capture.matches for (c, p), capture in station.items() if p == projector}
        )
        for projector in sorted({projector for _, projector in station})
    }
