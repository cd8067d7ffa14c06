"""Bands of a rolling shutter, in a projector's light alone: what that does not reach is dark, not lit by bands."""

import numpy as np

from scanner.decoding.light.brightness import Gains, Places
from scanner.decoding.light.equalise import correction
from scanner.decoding.planning import plan_sequence
from scanner.patterns import PRESETS

HEIGHT, LIT_ROWS, AMPLITUDE, AMBIENT, BANDS = 200, np.arange(40, 160), 50.0, 30.0, 0.15


def test_there_are_no_fringes_where_only_bands_are() -> None:
    fringe = plan_sequence(PRESETS["quick"].patterns((427, 240)), (427, 240)).fringes[0]
    steps, rows = np.arange(len(fringe.frames)), np.arange(HEIGHT)
    bands = 1 + BANDS * np.sin(2 * np.pi * (rows / 60 + 0.3 * steps[:, None] ** 2))
    gains = Gains(bands / np.exp(np.log(bands).mean(axis=0)))
    middle, is_lit = np.full(2 * HEIGHT, AMBIENT, np.float32), np.arange(2 * HEIGHT) < HEIGHT
    middle[is_lit] += AMPLITUDE
    brightest = np.where(is_lit, middle + AMPLITUDE, middle).astype(np.float32)
    at, phase = np.tile(rows, 2), 0.7
    told = Places(LIT_ROWS, HEIGHT)
    found = correction(fringe, gains, told, middle[LIT_ROWS], middle[LIT_ROWS], brightest[LIT_ROWS])
    waves = np.cos(phase + 2 * np.pi * np.array(fringe.shifts))[:, None]
    # Beside the picture is only the light of the room, which is steady.
    light = np.where(is_lit, middle + AMPLITUDE * waves, 0) * gains.at(at) + np.where(is_lit, 0, AMBIENT)
    first, second = (fringe.weights[1:] @ light).astype(np.float32)
    cosine, sine = found.apply(first, second, middle, brightest, at)
    seen, between = np.hypot(cosine, sine) > 0, np.isin(at, LIT_ROWS)
    assert np.array_equal(seen, is_lit & between)
    assert np.abs(np.hypot(cosine, sine)[seen] - AMPLITUDE).max() < 0.01
    assert np.abs(np.arctan2(sine, cosine)[seen] - phase).max() < 1e-3
