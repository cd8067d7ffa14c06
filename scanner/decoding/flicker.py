"""Brightness that changes from frame to frame: a projector's colour wheel or lamp, or the mains, against the exposure.

Some frames must be equally bright taken together: a pattern with its inverse and white with black, and each fringe over
its equal steps. How much they differ all over the image is flicker.
"""

from collections.abc import Sequence

import numpy as np

from scanner.decoding.arrays import Floats32
from scanner.decoding.medians import medians
from scanner.decoding.sequence_plan import SequencePlan

_FEWEST = 3


def flicker_of(plan: SequencePlan, levels: Floats32) -> float | None:
    """Standard deviation of the frames' brightness relative to its mean, from a sample (frames, P); None if unknown."""
    pairs = [levels[list(pair)].mean(axis=0) for pair in plan.complements]
    fringes = [fringe for fringe in plan.fringes if fringe.equal_steps]
    means = [levels[list(fringe.frames)].mean(axis=0) for fringe in fringes]
    found = [
        spread * np.sqrt(frames)
        for groups, frames in ((pairs, 2), (means, min((len(fringe.frames) for fringe in fringes), default=1)))
        if len(groups) >= _FEWEST and (spread := _spread(groups)) is not None
    ]
    return float(max(found)) if found else None


def _spread(groups: Sequence[Floats32]) -> float | None:
    """Of the groups' brightness, relative, where it is above the usual; None if it is so nowhere."""
    levels = np.stack(groups)
    usual = medians(levels, axis=0)
    lit = np.flatnonzero(usual > np.median(usual))
    if not len(lit):
        return None
    return float(np.std(medians(levels[:, lit] / usual[lit], axis=1), ddof=1))
