"""Can one trust this network? What the cameras say of each other, in plain words."""

from collections.abc import Iterator

import numpy as np

from calib.networks import DepthDisagreement
from scanner.networks.solve import SolvedNetwork
from scanner.quantities import percent
from scanner.results import MEASUREMENT_GRADE, Grade, Verdict

# Of the depth, and of what sigmas make of it: cameras that are further apart do not see one surface.
_APART, _FAR_APART, _OF_SIGMAS = 0.002, 0.02, 3.0
# Of what noise makes of cells, across the line on which a wall that is not flat moves them; and projector pixels that
# lenses and decoding leave. Cells that are further off follow another network than all others.
_STRAINED, _FOREIGN = 3.0, 15.0
_STRAINED_PX, _FOREIGN_PX = 0.1, 0.3
_NO_WALLS = 0.005  # of the distance: heights over planes that are none

MOVED = "Something moved between the captures, or a folder has another device's name: take these two again."
AS_SENT = "turn off keystone correction, digital zoom and aspect correction in its menu"
AS_SEEN = "turn off what its driver changes in its pictures, as lens correction does"
CHECK = "Check that nothing moved between the captures, and that the projectors correct no keystone."

_Finding = tuple[Grade, str, str]  # with headline and advice


def verdict_on(network: SolvedNetwork) -> Verdict:
    """The most serious finding decides."""
    reasons = tuple(_reasons(network))
    for grade, headline, advice in (*_refusals(network), *_doubts(network)):
        return Verdict(grade, headline, reasons, advice)
    return Verdict("good", f"{_together(network)}, and the cameras agree where they see the same light.", reasons)


def _together(network: SolvedNetwork) -> str:
    return f"{len(network.estimate.names)} devices are one network"


def _refusals(network: SolvedNetwork) -> Iterator[_Finding]:
    estimate = network.estimate
    yield from _warped(network)
    pair, strain = max(estimate.strains.items(), key=lambda entry: entry[1].across_px)
    if strain.across_px > max(_FOREIGN_PX, _FOREIGN * strain.noise_px):
        off = f"off by {strain.across_px:.2g} projector px"
        yield "refused", f"{pair[0]} in the light of {pair[1]} contradicts the others: {off}.", MOVED
    pair, strain = max(estimate.strains.items(), key=lambda entry: entry[1].uneven)
    if strain.uneven > _NO_WALLS:
        off = f"off flat by {percent(strain.uneven)} of their distance"
        yield "refused", f"{pair[0]} in the light of {pair[1]} sees walls that are {off}.", MOVED
    for disagreement in _disagreements(network):
        if disagreement.relative > max(_FAR_APART, _OF_SIGMAS * disagreement.expected):
            off = f"they are {percent(disagreement.relative)} apart"
            yield "refused", f"{disagreement.first} and {disagreement.second} do not see one surface: {off}.", MOVED


def _warped(network: SolvedNetwork) -> Iterator[_Finding]:
    """Pictures that are not shown as they are sent, or not recorded as they are seen."""
    warps, projectors = network.estimate.warps, network.surfaces
    if warps.moved:
        yield "refused", f"{warps.moved} was moved between its captures.", MOVED
    if warps.several:
        advice = f"For every projector {AS_SENT}, for every camera {AS_SEEN}, and take all captures again."
        yield "refused", "Pictures of several devices are warped, as by keystone correction.", advice
    if not warps.alone:
        return
    names = [warp.name for warp in warps.alone]
    remedies = [f"for {name} {AS_SENT if name in projectors else AS_SEEN}" for name in names]
    remedy = ", or ".join(remedies)
    advice = f"{remedy[0].upper()}{remedy[1:]}. Then take its captures again."
    if len(names) > 1:
        either = f"{', '.join(names[:-1])} or {names[-1]}"
        yield (
            "refused",
            f"The picture of {either} is warped, as by keystone correction; any of them explains it.",
            advice,
        )
        return
    off = f"one edge is {percent(warps.alone[0].trapezoid)} longer than the one opposite, where it should be as long"
    yield "refused", f"The picture of {names[0]} is warped, as by keystone correction: {off}.", advice


def _doubts(network: SolvedNetwork) -> Iterator[_Finding]:
    estimate, names, disagreements = network.estimate, _together(network), _disagreements(network)
    for disagreement in disagreements:
        if disagreement.relative > max(_APART, _OF_SIGMAS * disagreement.expected):
            off = f"{100 * disagreement.relative:.2g} % of the depth apart"
            yield "fair", f"{names}, but {disagreement.first} and {disagreement.second} are {off}.", CHECK
    pair, strain = max(estimate.strains.items(), key=lambda entry: entry[1].across_px)
    if strain.across_px > max(_STRAINED_PX, _STRAINED * strain.noise_px):
        off = f"off by {strain.across_px:.2g} projector px"
        yield "fair", f"{names}, but {pair[0]} in the light of {pair[1]} is {off}.", CHECK
    loose = max(estimate.names, key=lambda name: float(estimate.sigmas(name)[0]))
    sigma = float(estimate.sigmas(loose)[0])
    if sigma > MEASUREMENT_GRADE:
        beside = [f"{first} and {second}" for first, second, _ in estimate.alike if loose in (first, second)]
        advice = (
            f"{beside[0]} stand almost in one place: move one of them further away."
            if beside
            else "Let it see, or light, more of the walls that other devices share, from another side."
        )
        yield "fair", f"{names}, but the focal length of {loose} is known to {100 * sigma:.2g} % only.", advice
    if not disagreements:
        yield "fair", f"{names}, but no two cameras see the same light, so nothing checks it.", ""


def _disagreements(network: SolvedNetwork) -> list[DepthDisagreement]:
    """The largest first."""
    disagreements = (disagreement for surface in network.surfaces.values() for disagreement in surface.disagreements)
    return sorted(disagreements, key=lambda disagreement: -disagreement.relative)


def _reasons(network: SolvedNetwork) -> Iterator[str]:
    estimate = network.estimate
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
