"""Frames of different exposure with stripes that the camera hardly resolves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.decoding import MaskReason
from scanner.decoding.corrections.gains import gains_of_stripes
from scanner.patterns import sequence_for
from tests.support.synthetic_capture import Scene, decode

PIXELS = 4096


def fine_stripes(contrast: float, seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return a pattern and its inverse (2, P) in the same light, and the five coarser bits: 32 cells, each half lit."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0, 32, PIXELS)
    light = 100 * rng.uniform(0.5, 1.5, PIXELS) * np.exp(0.3 * np.sin(place / 5))
    side = np.where((place + 0.5) % 2 < 1, 0.5, -0.5) * contrast
    levels = light * np.exp([side, -side]) + rng.normal(0, 1, (2, PIXELS))
    number = place.astype(np.int64)
    return levels.astype(np.float32), [(number ^ number >> 1) >> bit & 1 == 1 for bit in range(4, -1, -1)]


@given(st.floats(-1.2, 1.2), st.floats(0.05, 1.2), st.integers(0, 1000))
def test_the_ratio_of_two_exposures_is_found_at_any_contrast(log_ratio: float, contrast: float, seed: int) -> None:
    levels, coarser = fine_stripes(contrast, seed)
    levels[0] *= np.exp(log_ratio)
    gains = gains_of_stripes(levels, coarser)
    within = 0.02 + 0.15 * contrast
    if gains is None:
        assert abs(log_ratio) < 2 * within, "told where it matters"
    else:
        assert np.log(gains.of_rows[0, 0] / gains.of_rows[1, 0]) == pytest.approx(log_ratio, abs=within)


def test_bits_that_light_one_side_only_are_no_difference_in_brightness() -> None:
    levels, coarser = fine_stripes(0.0, 1)
    levels[1] *= 0.2
    assert gains_of_stripes(levels, []) is None, "a bit that is the same everywhere"
    assert gains_of_stripes(levels, coarser[:2]) is None, "four cells do not tell"
    halves = np.where(coarser[0], levels, levels[::-1])
    assert gains_of_stripes(halves, coarser) is None, "a bit that is one of the coarser ones"


@pytest.mark.parametrize("with_white", [True, False])
def test_an_exposure_that_changes_threefold_costs_few_pixels(with_white: bool) -> None:
    scene = replace(Scene(), exposure=110.0, projector=(440, 300), camera_blur_px=0.9)
    patterns = sequence_for(scene.projector, cell=1, shifts=0)
    patterns = patterns if with_white else patterns[2:]
    frames = scene.frames(patterns)
    by = np.exp(np.random.default_rng(4).uniform(-0.55, 0.55, len(frames)))
    changed = [np.clip(np.rint(frame * g), 0, 255).astype(np.uint8) for frame, g in zip(frames, by, strict=True)]
    lit = scene.well_lit()
    steady, auto = (decode(patterns, each, scene.projector) for each in (frames, changed))
    kept = [float(np.mean(decoding.reasons[lit] == MaskReason.KEPT)) for decoding in (steady, auto)]
    assert 0.9 < kept[0] <= 1
    assert kept[1] > 0.85 * kept[0]
    errors = np.linalg.norm(scene.errors(auto), axis=1)
    assert 0.02 < np.median(errors) < 0.2
    assert np.mean(errors < 1) > 0.99
