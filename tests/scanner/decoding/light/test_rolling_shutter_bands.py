"""Rolling shutter bands affect only the projector's light: rows that it does not reach have no bands."""

import numpy as np

from scanner.decoding import plan_sequence
from scanner.decoding.light.brightness import Gains, LitRows
from scanner.patterns import PRESETS

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
    alike = np.stack([divided(k, frame[:, None], (rows, rows)) for k, frame in enumerate(light.astype(np.float32))])
    cosine, sine = fringe.weights32 @ alike[..., 0]
    seen = np.hypot(cosine, sine) > 0
    assert np.array_equal(seen, is_lit)
    assert np.abs(np.hypot(cosine, sine)[seen] - AMPLITUDE).max() < 0.01
    assert np.abs(np.arctan2(sine, cosine)[seen] - phase).max() < 1e-3
