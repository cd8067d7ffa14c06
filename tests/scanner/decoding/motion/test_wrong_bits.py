"""Period slips of segments of a surface, which edges of surfaces are not."""

import numpy as np
import pytest

from calib.numerics import Bools
from scanner.decoding import CoordinateMap, MaskReason, plan_sequence
from scanner.decoding.motion import mask_wrong_bits
from scanner.decoding.motion.wrong_bits import in_wrong_cycles
from scanner.patterns import PRESETS, sequence_for

SHAPE, PROJECTOR, PERIOD = (120, 160), (427, 240), 12.3
PLAN = plan_sequence(PRESETS["quick"].patterns(PROJECTOR), PROJECTOR)
SHADOW = np.s_[20:100, 60:90]


def maps(px: np.ndarray, border: Bools) -> CoordinateMap:
    """Return maps of coordinates (H, W, 2), without the pixels on a border, which are masked as not smooth."""
    left_out = border | np.roll(border, 1, axis=0) | np.roll(border, 1, axis=1)
    reason = np.where(left_out, np.uint8(MaskReason.ISOLATED), np.uint8(MaskReason.KEPT))
    noisy = px + np.random.default_rng(3).normal(0, 0.05, px.shape)
    noisy[left_out] = np.nan
    return CoordinateMap(
        noisy.astype(np.float32), np.full(SHAPE, 0.0025, np.float32), reason, np.zeros((2, len(MaskReason)), int)
    )


def wall() -> np.ndarray:
    """Return the coordinates (H, W, 2) of a wall seen obliquely."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    near = 1 + 0.001 * u
    return np.stack([30 + 1.6 * u / near, 20 + (1.4 * v + 0.1 * u) / near], axis=2)


def edge(shown: Bools) -> Bools:
    """Return the pixels on the border of the mask."""
    return (shown != np.roll(shown, -1, axis=0)) | (shown != np.roll(shown, -1, axis=1))


@pytest.mark.parametrize(("axis", "stripe_px", "cycles"), [(0, 16.0, 1), (0, 64.0, -3), (1, 16.0, 2)])
def test_only_lit_stripes_slip_in_a_shadow(axis: int, stripe_px: float, cycles: int) -> None:
    px = wall()
    shadow = np.zeros(SHAPE, np.bool_)
    shadow[SHADOW] = True
    turned = shadow & (px[..., axis] // stripe_px % 2 == 0)
    px[turned, axis] += cycles * PERIOD
    found = maps(px, edge(turned))
    kept = found.reason == MaskReason.KEPT
    wrong = in_wrong_cycles(PLAN, found)
    assert np.mean(wrong[turned & kept]) > 0.99
    assert np.mean(wrong[~turned & kept]) < 0.001
    assert 500 < np.count_nonzero(turned & kept) < 2000


def test_an_object_before_the_wall_is_no_period_slip() -> None:
    px = wall()
    thing = np.zeros(SHAPE, np.bool_)
    thing[30:90, 40:100] = True
    px[thing, 0] += 1.4 * PERIOD
    assert not in_wrong_cycles(PLAN, maps(px, edge(thing))).any()


def test_a_steep_surface_is_not_masked_as_wrong_bits() -> None:
    """With codes alone, beside a wall on which most neighbours share a cell."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    floor = v > 60 + 0.1 * u
    px = np.floor(np.stack([30 + 0.6 * u, 20 + 0.4 * v + 3.2 * np.maximum(v - 60 - 0.1 * u, 0)], axis=2))
    wrong = np.zeros(SHAPE, np.bool_)
    wrong[15:45, 100:130] = True
    px[wrong] = np.random.default_rng(4).integers(0, 240, (np.count_nonzero(wrong), 2))
    found = CoordinateMap(
        px.astype(np.float32),
        np.full(SHAPE, 1 / 12, np.float32),
        np.full(SHAPE, np.uint8(MaskReason.KEPT)),
        np.zeros((2, len(MaskReason)), int),
    )
    result = mask_wrong_bits(plan_sequence(sequence_for(PROJECTOR, cell=1, shifts=0), PROJECTOR), found, None)
    masked = result.masked_as(MaskReason.MOVED)
    assert not found.masked_as(MaskReason.MOVED).any(), "no map is edited"
    assert np.mean(masked[wrong]) > 0.95
    assert not masked[floor].any()
    assert 0.05 < np.mean(masked) < 0.12
