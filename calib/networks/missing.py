"""Devices that do not connect with a network, and where an overlap is missing."""

from collections.abc import Sequence

import numpy as np

from calib.finding import FindingKind
from calib.geometry import Size
from calib.networks.growth import Grown
from calib.numerics import Bools, Floats
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
            np.any([np.isfinite(grown.overlaps.seen[known, name].pixels[..., 0]) for name in names], axis=0)
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
