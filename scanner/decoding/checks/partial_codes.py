"""Pixels that did without some bits of their code, held against those that have all of them.

Where bits are missing because a pixel sees two cells, the others tell. Where they are missing because its light came
by way of other surfaces, or from inside of them, others may be wrong as well, and then break the epipolar geometry.
"""

import numpy as np

from calib.geometry import Matches
from calib.numerics import Bools, Floats
from scanner.decoding.checks.consequences import EPIPOLAR_PX, epipolar_matrix, from_epipolar_lines
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.sequence_plan import SequencePlan

_FEWEST = 100
_MOST_COMPARED = 4000
_MOST_WORSE = 0.05
_SEED = 6


def leave_out_wrong_partial_codes(plan: SequencePlan, maps: Maps) -> None:
    """Mask pixels that do without bits if they obey the epipolar geometry of the others too rarely; in place."""
    if plan.fringes or plan.only_axis is not None:
        return
    whole = np.float32(sum(axis.cell**2 for axis in plan.axes) / 24)
    kept = maps.reason == np.uint8(MaskReason.KEPT)
    partial = kept & (maps.variance > np.float32(1.01) * whole)
    some, others = _some(partial, maps), _some(kept & ~partial, maps)
    if min(len(some), len(others)) < _FEWEST:
        return
    matrix = epipolar_matrix(others)
    if matrix is None:
        return
    off, usually_off = (np.mean(from_epipolar_lines(one, matrix) > EPIPOLAR_PX) for one in (some, others))
    if off > usually_off + _MOST_WORSE:
        np.copyto(maps.reason, np.uint8(MaskReason.UNDECIDED), where=partial)


def _some(chosen: Bools, maps: Maps) -> Matches:
    row, column = np.nonzero(chosen)
    few = np.random.default_rng(_SEED).choice(len(row), min(len(row), _MOST_COMPARED), replace=False)
    camera_px: Floats = np.stack([column[few], row[few]], axis=1).astype(np.float64)
    return Matches(camera_px, maps.projector_px[row[few], column[few]].astype(np.float64))
