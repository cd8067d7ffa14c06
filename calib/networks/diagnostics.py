"""What contradicts a network, weakens it or is missing: mirrored pictures, pairs that are off, no overlap."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.estimation import Fit
from calib.finding import FindingKind
from calib.geometry import Matches, Size
from calib.networks.initialisation import Grown
from calib.networks.network import Network
from calib.networks.observations import PairName, PlaneObservation
from calib.networks.raster import ImageRaster, SeenAt
from calib.numerics import Bools, Floats, evenly, median, robust_sigma
from calib.refusal import RefusalError

_FEWEST = 30  # cells that both see
_WIDE = 0.75  # of a picture's width or height: more is all of it

NOT_CONNECTED = FindingKind(
    "not-connected",
    "Devices of a network share too little with the others to be placed.",
    "Take a capture of one of them together with one of the others, or let them see more of what the others see.",
)


def not_connected(grown: Grown) -> RefusalError:
    """Names the devices, and says for one of them what would have to be seen, or taken."""
    loose = sorted({name for pair in grown.waiting for name in pair} - set(grown.names))
    reason = f"{', '.join(loose)}: not connected with {', '.join(grown.names)}."
    bridges = [pair for pair in grown.waiting if any(name in grown.names for name in pair)]
    if not bridges:
        camera, projector = grown.waiting[0]
        placed_camera, placed_projector = grown.names[:2]
        return RefusalError(
            NOT_CONNECTED,
            f"{reason} No capture is of one of these and one of those.",
            f"Take one of {placed_camera} in the light of {projector}, or of {camera} in that of {placed_projector}.",
        )
    where, advice = _overlap(grown, bridges)
    return RefusalError(NOT_CONNECTED, f"{reason} {where}", advice)


def _overlap(grown: Grown, bridges: Sequence[tuple[str, str]]) -> tuple[str, str]:
    """Of the pair of a placed and a loose device with most in common: what it lacks, and what to do."""
    candidates = []
    for pair in bridges:
        known, new = pair if pair[0] in grown.names else pair[::-1]
        partners = [name for pair in grown.labelled if known in pair for name in pair if name != known]
        by_new, by_others = (
            np.any([np.isfinite(grown.overlaps.sightings[known, name].pixels[..., 0]) for name in names], axis=0)
            for names in ([new], partners)
        )
        candidates.append((np.count_nonzero(by_new & by_others), known, new, partners[0], by_new, by_others))
    count, known, new, partner, by_new, by_others = max(candidates, key=lambda candidate: candidate[0])
    size, centres = grown.knowledge.sizes[known], grown.overlaps.rasters[known].centres
    verb, lit = ("sees", "see") if known not in grown.knowledge.cameras else ("lights", "light")
    if count < _FEWEST:
        here, there = _part(size, centres, by_new), _part(size, centres, by_others)
        return (
            f"In the picture of {known}, {new} {verb} {here} and {partner} {there}: nothing that both {lit}.",
            f"Let {partner} {lit} what {new} {verb} there, or {new} what {partner} {verb}.",
        )
    return (
        f"What {new} and {partner} both {lit} in the picture of {known}, {_part(size, centres, by_new & by_others)}, "
        f"is too little to place {new}.",
        f"Let {new} {lit} more of what {partner} {verb}, on more than one wall.",
    )


def _part(size: Size, centres: Floats, chosen: Bools) -> str:
    """Which part of a picture cells (h, w) are, in words."""
    if not chosen.any():
        return "nothing"
    low, high = np.percentile(centres[chosen], [5, 95], axis=0) / np.array(size)
    names = []
    for axis, (before, middle, after) in ((1, ("upper", "", "lower")), (0, ("left", "", "right"))):
        mean = (low[axis] + high[axis]) / 2
        wide = high[axis] - low[axis] > _WIDE
        names.append(middle if wide or 0.4 < mean < 0.6 else before if mean < 0.5 else after)
    words = " ".join(name for name in names if name)
    if words:
        return f"its {words} part"
    return "all of it" if (high - low > _WIDE).all() else "its middle"


_SAMPLE = 20_000
_ALIKE = 0.03  # of the distance of what they see, as of a rig's baseline in `calib.diagnostics`

MIRRORED = FindingKind(
    "mirrored",
    "A device's picture is seen as in a mirror.",
    "Switch mirroring, as for rear projection or ceiling mount, off in its settings; do not photograph its picture in "
    "a mirror.",
)


def refuse_mirrored(captures: Mapping[PairName, Matches], sizes: Mapping[str, Size]) -> None:
    """Raise RefusalError for devices whose pictures are mirrored in all captures.

    A camera and a projector are on the same side of a surface, so that no map between their pictures is mirrored.
    """
    turned = {pair: _is_mirrored(matches, sizes[pair[1]]) for pair, matches in captures.items()}
    for role, kind in ((1, "projectors"), (0, "cameras")):
        names = {pair[role] for pair in turned}
        wrong = {name for name in names if all(turned[pair] for pair in turned if pair[role] == name)}
        if wrong:
            raise RefusalError(
                MIRRORED,
                f"The picture of {' and '.join(sorted(wrong))} is seen as in a mirror.",
                f"Switch mirroring, as for rear projection, off in the settings of these {kind}; or on, where light "
                "takes a mirror on its way.",
            )
    if any(turned.values()):
        camera, projector = next(pair for pair, mirrored in turned.items() if mirrored)
        raise RefusalError(
            MIRRORED,
            f"{camera} in the light of {projector} is seen as in a mirror, but not in other captures of these two.",
            "Take it again, with the same settings of all devices.",
        )


def _is_mirrored(matches: Matches, size: Size) -> bool:
    some = matches[evenly(np.ones(len(matches), np.bool_), _SAMPLE)]
    by_own = SeenAt.of(ImageRaster.fine(size, [some.projector_px]), some.projector_px, some.camera_px).by_own
    known = by_own[np.isfinite(by_own).all(axis=(-2, -1))]
    return len(known) > 0 and float(np.median(np.linalg.det(known))) < 0


@dataclass(frozen=True)
class Strain:
    """How far a pair's cells are off, the median as a standard deviation: `across_px` the line on which a wall that is
    not flat moves them, where noise makes `noise_px` of it; and as heights over the planes, `uneven`, relative to the
    camera's distance.
    """

    across_px: float
    noise_px: float
    uneven: float


def strains(sights: Sequence[PlaneObservation], fit: Fit[Network]) -> dict[int, Strain]:
    """By number of the pair, of all that have a sight."""
    residuals: dict[int, list[Floats]] = {}
    for sight, residual in zip(sights, fit.residuals, strict=True):
        by_height = sight.predict(fit.state)[1][:, :, -1]
        size = np.linalg.norm(by_height, axis=1)
        across = (by_height[:, 1] * residual[:, 0] - by_height[:, 0] * residual[:, 1]) / size
        height = np.sum(by_height * residual, axis=1) / size**2
        eye = fit.state.devices[sight.camera].pose.translation
        relative = height / np.linalg.norm(sight.points(fit.state) - eye, axis=1)
        residuals.setdefault(sight.capture, []).append(np.abs([across, sight.cells.sigma_px, relative]))
    return {
        capture: Strain(robust_sigma(across), median(sigma), robust_sigma(relative))
        for capture, of_capture in residuals.items()
        for across, sigma, relative in (np.concatenate(of_capture, axis=1),)
    }


def standing_alike(
    names: Sequence[str], sights: Sequence[PlaneObservation], network: Network
) -> list[tuple[str, str, float]]:
    """Devices that are nearly in one place, with their distance over that of what they see."""
    rays: dict[int, list[Floats]] = {}
    for sight in sights:
        points = sight.points(network)
        for device in (sight.camera, sight.projector):
            away = np.linalg.norm(points - network.devices[device].pose.translation, axis=1)
            rays.setdefault(device, []).append(away)
    pairs = []
    for i, j in combinations(sorted(rays), 2):
        places = [network.devices[number].pose.translation for number in (i, j)]
        reach = min(float(np.median(np.concatenate(rays[number]))) for number in (i, j))
        apart = float(np.linalg.norm(places[1] - places[0])) / reach
        if apart < _ALIKE:
            pairs.append((names[i], names[j], apart))
    return pairs
