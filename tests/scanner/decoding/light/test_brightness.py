"""Bands of a rolling shutter affect only the projector's light; dim light costs accuracy, not pixels."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.numerics import Image
from scanner.decoding import plan_sequence
from scanner.decoding.light.brightness import Gains, LitRows
from scanner.patterns import PRESETS, sequence_for
from tests.support.synthetic_capture import Scene, decode

HEIGHT, LIT_ROWS, AMPLITUDE, AMBIENT, BANDS = 200, np.arange(40, 160), 50.0, 30.0, 0.15


def test_bands_beyond_the_picture_give_no_fringes() -> None:
    fringe = plan_sequence(PRESETS["quick"].patterns((427, 240)), (427, 240)).fringes[0]
    steps, rows = np.arange(len(fringe.frames)), np.arange(HEIGHT)
    bands = 1 + BANDS * np.sin(2 * np.pi * (rows / 60 + 0.3 * steps[:, None] ** 2))
    gains = Gains(bands / np.exp(np.log(bands).mean(axis=0)))
    is_lit, phase = np.isin(rows, LIT_ROWS), 0.7
    middle = np.where(is_lit, AMBIENT + AMPLITUDE, AMBIENT)
    waves = np.cos(phase + 2 * np.pi * np.array(fringe.shifts))[:, None]
    # Outside the picture there is only steady room light.
    light = np.where(is_lit, (middle + AMPLITUDE * waves) * gains.at(rows), AMBIENT)
    divided = gains.within(LitRows(LIT_ROWS, HEIGHT)).divided
    alike = np.stack([divided(k, frame, rows) for k, frame in enumerate(light.astype(np.float32))])
    cosine, sine = fringe.weights32 @ alike
    seen = np.hypot(cosine, sine) > 0
    assert np.array_equal(seen, is_lit)
    assert np.abs(np.hypot(cosine, sine)[seen] - AMPLITUDE).max() < 0.01
    assert np.abs(np.arctan2(sine, cosine)[seen] - phase).max() < 1e-3


SCENE = replace(Scene(), ambient=1.0, read_noise=0.5, electrons_per_level=100.0)
GRAY = sequence_for(SCENE.projector, code="gray", cell=1, inverses=True, shifts=0)


def as_jpeg(image: Image) -> Image:
    whole, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 75])
    assert whole
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)


@pytest.mark.parametrize(
    ("exposure", "stored", "kept", "error_px"),
    [(50.0, np.asarray, 0.99, 0.015), (25.0, np.asarray, 0.94, 0.03), (40.0, as_jpeg, 0.97, 0.04)],
    ids=["a quarter", "an eighth", "a fifth, as JPEG"],
)
def test_codes_in_little_light(exposure: float, stored: Callable[[Image], Image], kept: float, error_px: float) -> None:
    scene = replace(SCENE, exposure=exposure)
    decoding = decode(GRAY, [stored(frame) for frame in scene.frames(GRAY)], scene.projector)
    errors = np.abs(scene.errors(decoding))
    assert np.mean(decoding.reasons[scene.well_lit()] == 0) > kept
    assert 0.3 * error_px < np.median(errors) < error_px
    assert np.mean(errors > 1) < 1e-3


def test_shadows_stay_dark() -> None:
    """Shadows contain interreflection, a tenth of the direct light."""
    scene = replace(SCENE, exposure=50.0)
    decoding = scene.decode(GRAY)
    u, v = np.meshgrid(*(np.arange(float(size)) for size in scene.camera))
    shadow = cv2.erode(scene.is_shadow(u, v).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert np.count_nonzero(shadow) > 500
    assert np.mean(decoding.reasons[shadow] == 0) < 0.02
