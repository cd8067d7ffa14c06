"""Can one trust this network? What the cameras say of each other, in plain words."""

from collections.abc import Iterator

import numpy as np

from calib.finding import Datum, Finding, FindingKind, Severity
from calib.networks import DepthDisagreement, Strain
from scanner.networks.solve import SolvedNetwork
from scanner.quantities import percent
from scanner.results import MEASUREMENT_GRADE, Verdict
from scanner.shown_text import capitalised

# Of the depth, and of what sigmas make of it: cameras that are further apart do not see one surface.
_APART, _FAR_APART, _OF_SIGMAS = 0.002, 0.02, 3.0
# Of what noise makes of cells, across the line on which a wall that is not flat moves them; and projector pixels that
# lenses and decoding leave. Cells that are further off follow another network than all others.
_STRAINED, _FOREIGN = 3.0, 15.0
_STRAINED_PX, _FOREIGN_PX = 0.1, 0.3
# By how many sigmas, root mean square over ten or so, pairs that are calibrated by themselves differ from the network.
_DIFFERENT, _FAR_DIFFERENT = 2.0, 5.0
_CHANGED = 0.02  # of what two cameras see at a station; 0.0001 where nothing moves
_NO_WALLS = 0.005  # of the distance: heights over planes that are none

MOVED = "Something moved between the captures, or a folder has another device's name: take these two again."
AS_SENT = "turn off keystone correction, digital zoom and aspect correction in its menu"
AS_SEEN = "turn off what its driver changes in its pictures, as lens correction does"
CHECK = "Check that nothing moved between the captures, and that the projectors correct no keystone."

WARPED_PICTURE = FindingKind(
    "warped-picture",
    "A picture is not shown as it is sent, or not recorded as it is seen, as by keystone correction.",
    "Turn off keystone correction, digital zoom and aspect correction in the projector's menu, and what the camera's "
    "driver changes in its pictures; then take the captures again.",
    ("trapezoid_share",),
)
DEVICE_MOVED = FindingKind(
    "device-moved",
    "A device of a network was moved between its captures.",
    "Take the captures of this device again, without moving anything.",
)
PAIR_CONTRADICTS = FindingKind(
    "pair-contradicts",
    "A pair of a network contradicts the others: its matches are off, or its walls are not flat.",
    "Something moved between the captures, or a folder has another device's name: take this pair again.",
    ("off_px", "noise_px", "uneven_share"),
)
CAMERAS_DISAGREE = FindingKind(
    "cameras-disagree",
    "Two cameras of a network see one surface at different places.",
    "Check that nothing moved between the captures, and that the projectors correct no keystone.",
    ("apart_share", "expected_share"),
)
PAIR_DISAGREES = FindingKind(
    "pair-disagrees",
    "The stations of one pair of a network calibrate it otherwise than all pairs together do.",
    "Check that no device was touched between the stations, zoom and focus included, and take them again.",
    ("deviation_ratio",),
)
STATION_CHANGED = FindingKind(
    "station-changed",
    "Something moved between the captures of one station of a network.",
    "Take this station again, or leave it out.",
    ("elsewhere_share",),
)
LOOSE_DEVICE = FindingKind(
    "loose-device",
    "The focal length of a device of a network is known poorly.",
    "Let it see, or light, more of the walls that other devices share, from another side.",
    ("sigma_percent",),
)
NOTHING_CHECKS = FindingKind(
    "nothing-checks",
    "No two cameras of a network see the same light, so nothing checks them against each other.",
    "Let two cameras see the light of one projector.",
)
STANDING_ALIKE = FindingKind(
    "standing-alike",
    "Two devices of a network stand almost in one place, so that they hardly determine each other.",
    "Move one of them further away.",
    ("apart_share",),
)


def verdict_on(network: SolvedNetwork) -> Verdict:
    """The most serious finding decides."""
    findings = (*_refusals(network), *_doubts(network), *_notes(network))
    reasons, decisive = tuple(_reasons(network)), findings[0] if findings else None
    if decisive is not None and decisive.severity == Severity.REFUSAL:
        kinds = (decisive.kind, STANDING_ALIKE)
        return Verdict("refused", decisive.message, reasons, decisive.advice, findings, kinds)
    if decisive is not None and decisive.severity == Severity.WARNING:
        headline = f"{_together(network)}, but {decisive.message}"
        return Verdict("fair", headline, reasons, decisive.advice, findings, (decisive.kind, STANDING_ALIKE))
    headline = f"{_together(network)}, and the cameras agree where they see the same light."
    return Verdict("good", headline, reasons, findings=findings, kinds=(STANDING_ALIKE,))


def _together(network: SolvedNetwork) -> str:
    return f"All {len(network.estimate.names)} devices fit together as one network"


def _refusals(network: SolvedNetwork) -> Iterator[Finding]:
    estimate = network.estimate
    yield from _warped(network)
    (camera, projector), strain = max(estimate.strains.items(), key=lambda item: item[1].across_px)
    if _is_off(strain, _FOREIGN_PX, _FOREIGN):
        yield Finding(
            PAIR_CONTRADICTS,
            Severity.REFUSAL,
            f"{camera} in the light of {projector} contradicts the others: off by {strain.across_px:.2g} projector px.",
            MOVED,
            {"off_px": strain.across_px, "noise_px": strain.noise_px},
        )
    (camera, projector), strain = max(estimate.strains.items(), key=lambda item: item[1].uneven)
    if strain.uneven > _NO_WALLS:
        off = f"off flat by {percent(strain.uneven)} of their distance"
        yield Finding(
            PAIR_CONTRADICTS,
            Severity.REFUSAL,
            f"{camera} in the light of {projector} sees walls that are {off}.",
            MOVED,
            {"uneven_share": strain.uneven},
        )
    yield from _differing(network, Severity.REFUSAL, _FAR_DIFFERENT, np.inf)
    for pair in _disagreements(network):
        if _is_apart(pair, _FAR_APART):
            off = f"they are {percent(pair.relative)} apart"
            message = f"{pair.first} and {pair.second} do not see one surface: {off}."
            yield Finding(CAMERAS_DISAGREE, Severity.REFUSAL, message, MOVED, _distances(pair))


def _differing(network: SolvedNetwork, severity: Severity, least: float, most: float) -> Iterator[Finding]:
    """The pair whose own calibration differs most from the network, if by as many sigmas."""
    differences = network.estimate.disagreements
    camera, projector = max(differences, key=differences.__getitem__, default=("", ""))
    sigmas = differences.get((camera, projector), 0.0)
    if least <= sigmas < most:
        message = (
            f"the stations of {camera} in the light of {projector} calibrate it otherwise than all pairs together, by "
            f"{sigmas:.1f} sigmas."
        )
        yield Finding(PAIR_DISAGREES, severity, message, PAIR_DISAGREES.remedy, {"deviation_ratio": sigmas})


def _changed(network: SolvedNetwork) -> Iterator[Finding]:
    """Stations at which two cameras see part of a projector's light on another surface."""
    for number, station in enumerate(network.stations if network.further else (), start=1):
        pairs = [pair for surface in station.values() for pair in surface.disagreements]
        worst = max(pairs, key=lambda pair: pair.elsewhere, default=None)
        if worst is not None and worst.elsewhere > _CHANGED:
            message = (
                f"at station {number}, {worst.first} and {worst.second} see {percent(worst.elsewhere)} of what both "
                "see at other places: something moved between its captures."
            )
            yield Finding(
                STATION_CHANGED, Severity.WARNING, message, STATION_CHANGED.remedy, {"elsewhere_share": worst.elsewhere}
            )


def _warped(network: SolvedNetwork) -> Iterator[Finding]:
    """Pictures that are not shown as they are sent, or not recorded as they are seen."""
    warps, projectors = network.estimate.warps, network.surfaces
    if warps.moved:
        message = f"{warps.moved} was moved between its captures."
        yield Finding(DEVICE_MOVED, Severity.REFUSAL, message, DEVICE_MOVED.remedy)
    if warps.several:
        message = "Pictures of several devices are warped, as by keystone correction."
        advice = f"For every projector {AS_SENT}, for every camera {AS_SEEN}, and take all captures again."
        yield Finding(WARPED_PICTURE, Severity.REFUSAL, message, advice)
    if not warps.alone:
        return
    names = [warp.name for warp in warps.alone]
    remedies = [f"for {name} {AS_SENT if name in projectors else AS_SEEN}" for name in names]
    advice = f"{capitalised(', or '.join(remedies))}. Then take its captures again."
    if len(names) > 1:
        either = f"{', '.join(names[:-1])} or {names[-1]}"
        message = f"The picture of {either} is warped, as by keystone correction; any of them explains it."
        yield Finding(WARPED_PICTURE, Severity.REFUSAL, message, advice)
        return
    trapezoid = warps.alone[0].trapezoid
    off = f"one edge is {percent(trapezoid)} longer than the one opposite, where it should be as long"
    message = f"The picture of {names[0]} is warped, as by keystone correction: {off}."
    yield Finding(WARPED_PICTURE, Severity.REFUSAL, message, advice, {"trapezoid_share": float(trapezoid)})


def _doubts(network: SolvedNetwork) -> Iterator[Finding]:
    estimate, disagreements = network.estimate, _disagreements(network)
    for pair in disagreements:
        if _is_apart(pair, _APART) and not _is_apart(pair, _FAR_APART):
            message = f"{pair.first} and {pair.second} are {100 * pair.relative:.2g} % of the depth apart."
            yield Finding(CAMERAS_DISAGREE, Severity.WARNING, message, CHECK, _distances(pair))
    (camera, projector), strain = max(estimate.strains.items(), key=lambda item: item[1].across_px)
    if _is_off(strain, _STRAINED_PX, _STRAINED) and not _is_off(strain, _FOREIGN_PX, _FOREIGN):
        yield Finding(
            PAIR_CONTRADICTS,
            Severity.WARNING,
            f"{camera} in the light of {projector} is off by {strain.across_px:.2g} projector px.",
            CHECK,
            {"off_px": strain.across_px, "noise_px": strain.noise_px},
        )
    yield from _differing(network, Severity.WARNING, _DIFFERENT, _FAR_DIFFERENT)
    yield from _changed(network)
    loose = max(estimate.names, key=lambda name: float(estimate.sigmas(name)[0]))
    sigma = float(estimate.sigmas(loose)[0])
    if sigma > MEASUREMENT_GRADE:
        beside = [f"{first} and {second}" for first, second, _ in estimate.alike if loose in (first, second)]
        yield Finding(
            LOOSE_DEVICE,
            Severity.WARNING,
            f"the focal length of {loose} is known to {100 * sigma:.2g} % only.",
            f"{beside[0]} stand almost in one place: move one of them further away." if beside else LOOSE_DEVICE.remedy,
            {"sigma_percent": 100 * sigma},
        )
    if not disagreements:
        message = "no two cameras see the same light, so nothing checks it."
        yield Finding(NOTHING_CHECKS, Severity.WARNING, message)


def _notes(network: SolvedNetwork) -> Iterator[Finding]:
    yield from network.findings
    for first, second, apart in network.estimate.alike:
        yield Finding(
            STANDING_ALIKE,
            Severity.NOTE,
            f"{first} and {second} stand almost in one place, {percent(apart)} of the distance of what they see apart.",
            data={"apart_share": apart},
        )


def _is_off(strain: Strain, least_px: float, of_noise: float) -> bool:
    return strain.across_px > max(least_px, of_noise * strain.noise_px)


def _is_apart(pair: DepthDisagreement, least: float) -> bool:
    return pair.relative > max(least, _OF_SIGMAS * pair.expected)


def _distances(pair: DepthDisagreement) -> dict[str, Datum]:
    return {"apart_share": pair.relative, "expected_share": pair.expected}


def _disagreements(network: SolvedNetwork) -> list[DepthDisagreement]:
    """Of all stations, the largest first."""
    surfaces = (surface for station in network.stations for surface in station.values())
    disagreements = (disagreement for surface in surfaces for disagreement in surface.disagreements)
    return sorted(disagreements, key=lambda disagreement: -disagreement.relative)


def _reasons(network: SolvedNetwork) -> Iterator[str]:
    estimate = network.estimate
    yield from (finding.message for finding in network.findings)
    for first, second, apart in estimate.alike:
        yield (
            f"{first} and {second} stand almost in one place, {percent(apart)} of the distance of what they see apart."
        )
    sigma = max(float(estimate.sigmas(name)[0]) for name in estimate.names)
    yield f"All focal lengths are known to {100 * sigma:.2g} % or better."
    for projector, surface in network.surfaces.items():
        for disagreement in surface.disagreements:
            yield (
                f"In the light of {projector}, {disagreement.first} and {disagreement.second} are "
                f"{100 * disagreement.relative:.2g} % of the depth apart at {disagreement.count:,} places; by the "
                f"sigmas it is {100 * disagreement.expected:.2g} %."
            )
        if np.isfinite(surface.gain):
            yield f"Points of {projector} that several cameras see have sigmas {surface.gain:.2f} times smaller."
