"""One frame is brighter or darker than the others, by lamp, exposure or shutter: no pixel becomes wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics import Image
from scanner.decoding import MaskReason
from scanner.decoding.corrections.gains import BitLevels, levels_of_bit, white_of
from scanner.patterns import PRESETS, PresetName
from tests.support.findings import kinds_of
from tests.support.synthetic_capture import Scene, decode

SCENE = Scene(camera=(240, 180), projector=(427, 280), indirect=0.5)
# White, coarse and finest bits, the base of the XOR code and a bit relative to it, steps of the last fringe.
CASES: list[tuple[PresetName, int, float]] = [
    *(("quick", number, 0.6) for number in (7, 8, 13)),
    ("quick", 0, 1.4),
    *(("standard", number, factor) for number in (34, 41) for factor in (0.6, 1.4)),
    *(("concave", number, 0.6) for number in (7, 18)),
    *(("concave", number, 1.4) for number in (8, 22)),
]


@pytest.mark.parametrize(("preset", "number", "factor"), CASES)
def test_one_brighter_frame_causes_no_wrong_matches(preset: PresetName, number: int, factor: float) -> None:
    patterns = PRESETS[preset].patterns(SCENE.projector)
    frames = SCENE.frames(patterns)
    frames[number] = np.rint(np.clip(factor * frames[number].astype(float), 0, 255)).astype(np.uint8)
    decoding = decode(patterns, frames, SCENE.projector)
    errors = np.abs(SCENE.errors(decoding)).max(axis=1)
    assert 0.01 < np.median(errors) < 0.06
    assert np.mean(errors > 1) < 1e-3
    assert np.mean(decoding.reasons[SCENE.well_lit()] == MaskReason.KEPT) > 0.97
    assert ("brighter-white" in kinds_of(decoding.findings)) == (number == 0)


def frame_of_bit(gain: float, dark: float, bright: float, ambient: float) -> tuple[Image, Image, Image, np.ndarray]:
    """Return a bit's frame of 60 × 80 pixels, the half-way level, white, and which pixels are lit."""
    rng = np.random.default_rng(3)
    black = ambient * rng.uniform(0.8, 1.2, (60, 80))
    swing = 100 * rng.uniform(0.4, 1.0, (60, 80))
    lit = rng.random((60, 80)) < 0.3
    seen = gain * (black + np.where(lit, bright, dark) * swing) + rng.normal(0, 0.7, (60, 80))
    frame, middle, white = (
        np.rint(np.clip(level, 0, 255)).astype(np.uint8) for level in (seen, black + swing / 2, black + swing)
    )
    return frame, middle, white, lit


@given(gain=st.floats(0.5, 1.6), dark=st.floats(0, 0.2), bright=st.floats(0.6, 1), ambient=st.floats(0, 60))
def test_bits_are_thresholded_between_their_own_two_levels(
    gain: float, dark: float, bright: float, ambient: float
) -> None:
    frame, middle, white, lit = frame_of_bit(gain, dark, bright, ambient)
    levels = levels_of_bit(frame.ravel(), middle.ravel(), white.ravel())
    assert levels is not None
    assert np.mean((frame > levels.threshold(middle, white)) == lit) > 0.999
    assert levels.bright - levels.dark == pytest.approx(gain * (bright - dark), abs=0.03)


def test_a_uniform_frame_has_no_bit_levels() -> None:
    frame, middle, white, _ = frame_of_bit(1.0, 0.5, 0.5, 10.0)
    assert levels_of_bit(frame.ravel(), middle.ravel(), white.ravel()) is None


@pytest.mark.parametrize(
    ("dark", "bright", "white"),
    [
        (0.0, 1.0, 1.0),
        (0.2, 0.8, 1.0),  # bounced light
        (0.0, 0.7, 0.7),  # a white frame that was exposed longer
        (0.2, 1.4, 1.6),  # a darker one, and bounced light
        (0.1, 1.1, 1.0),  # light that was switched on after it
        (-0.1, 0.9, 1.0),  # … off
    ],
)
def test_a_brighter_white_is_distinguished_from_other_light(dark: float, bright: float, white: float) -> None:
    bits = [BitLevels(1.0, dark + off, bright - off, 0.0) for off in (-0.01, 0.0, 0.0, 0.02)]
    assert white_of(bits) == pytest.approx(white, abs=0.03)
