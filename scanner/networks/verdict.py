"""Can one trust this network? What the cameras say of each other, in plain words."""

from collections.abc import Iterator

import numpy as np

from calib.refinement import Noise
from scanner.networks.solve import SolvedNetwork
from scanner.quantities import percent
from scanner.results import MEASUREMENT_GRADE, Verdict

# Of the depth, and of what sigmas make of it: cameras that are further apart do not see one surface.
_APART, _OF_SIGMAS = 0.002, 3.0
_FAR_APART = 0.02
# Projector pixels: cells of matches that are off by more follow another network than all others.
_STRAINED_PX, _FOREIGN_PX = 0.25, 1.0

_KEYSTONE, _OVER_NEXT = 25.0, 3.0  # χ² of pixels that are not square; over that of any other projector

MOVED = "Something moved between the captures, or a folder has another device's name: take these two again."

CHECK = "Check that nothing moved between the captures, and that the projectors correct no keystone."


def verdict_on(network: SolvedNetwork) -> Verdict:
    """The most serious finding decides."""
    estimate, reasons = network.estimate, tuple(_reasons(network))
    found = [each for surface in network.surfaces.values() for each in surface.disagreements]
    worst = max(found, key=lambda each: each.relative, default=None)
    names = f"{len(estimate.names)} devices are one network"
    strained = max(estimate.noise, key=lambda pair: _off_px(estimate.noise[pair]))
    off_px = _off_px(estimate.noise[strained])
    if off_px > _FOREIGN_PX:
        return Verdict(
            "refused",
            f"{strained[0]} in the light of {strained[1]} contradicts the others: off by {off_px:.2g} projector px.",
            reasons,
            _keystone(network) or MOVED,
        )
    if worst is not None and worst.relative > max(_FAR_APART, _OF_SIGMAS * worst.expected):
        return Verdict(
            "refused",
            f"{worst.first} and {worst.second} do not see one surface: they are {percent(worst.relative)} apart.",
            reasons,
            _keystone(network) or MOVED,
        )
    if worst is not None and worst.relative > max(_APART, _OF_SIGMAS * worst.expected):
        return Verdict(
            "fair",
            f"{names}, but {worst.first} and {worst.second} are {100 * worst.relative:.2g} % of the depth apart.",
            reasons,
            _keystone(network) or CHECK,
        )
    if off_px > _STRAINED_PX:
        return Verdict(
            "fair",
            f"{names}, but {strained[0]} in the light of {strained[1]} is off by {off_px:.2g} projector px.",
            reasons,
            _keystone(network) or CHECK,
        )
    loose = max(estimate.names, key=lambda name: float(estimate.sigmas(name)[0]))
    sigma = float(estimate.sigmas(loose)[0])
    alike = [(first, second) for first, second, _ in estimate.alike if loose in (first, second)]
    if sigma > MEASUREMENT_GRADE:
        return Verdict(
            "fair",
            f"{names}, but the focal length of {loose} is known to {100 * sigma:.2g} % only.",
            reasons,
            f"{' and '.join(alike[0])} stand almost in one place: move one of them further away."
            if alike
            else "Let it see, or light, more of the walls that other devices share, from another side.",
        )
    if not found:
        return Verdict("fair", f"{names}, but no two cameras see the same light, so nothing checks it.", reasons)
    return Verdict("good", f"{names}, and the cameras agree where they see the same light.", reasons)


def _keystone(network: SolvedNetwork) -> str:
    """Advice, where one projector's pixels do not seem to be square."""
    estimate = network.estimate
    shapes = {
        name: shape for name, shape in zip(estimate.names, estimate.shapes, strict=True) if name in network.surfaces
    }
    first, *others = sorted(shapes, key=lambda name: -shapes[name].significance)
    most = shapes[first]
    if most.significance < max(_KEYSTONE, *(_OVER_NEXT * shapes[name].significance for name in others), 0.0):
        return ""
    return (
        f"Turn off keystone correction, digital zoom and aspect correction in the menu of {first}, and take its "
        f"captures again: pixels that are {percent(abs(most.aspect))} off square would fit better."
    )


def _off_px(noise: Noise) -> float:
    """What stays in the means of cells, rough and smooth."""
    return float(np.hypot(noise.systematic_px, noise.smooth_px))


def _reasons(network: SolvedNetwork) -> Iterator[str]:
    estimate = network.estimate
    for one, other, apart in estimate.alike:
        yield f"{one} and {other} stand almost in one place, {percent(apart)} of the distance of what they see apart."
    sigma = max(float(estimate.sigmas(name)[0]) for name in estimate.names)
    yield f"All focal lengths are known to {100 * sigma:.2g} % or better."
    for projector, surface in network.surfaces.items():
        for each in surface.disagreements:
            yield (
                f"In the light of {projector}, {each.first} and {each.second} are {100 * each.relative:.2g} % of the "
                f"depth apart at {each.count:,} places; by the sigmas it is {100 * each.expected:.2g} %."
            )
        if np.isfinite(surface.gain):
            yield f"Points of {projector} that several cameras see have sigmas {surface.gain:.2f} times smaller."
