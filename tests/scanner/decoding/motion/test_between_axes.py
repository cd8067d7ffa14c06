"""Locating the time of a change in a series of pictures of one scene."""

from collections.abc import Iterable

import numpy as np
import pytest

from calib.numerics import Floats32
from scanner.decoding.motion.between_axes import _add_up, time_of_change

SHAPE = (48, 64)
STRIPES = (16.0, 8.0, 4.0, 2.0, 1.0) * 2


def picture(shift: int) -> Floats32:
    """Return a wavy scene, (P,), shifted to the right by a number of pixels."""
    x = np.arange(SHAPE[1]) - shift
    return np.broadcast_to(120 + 60 * np.sin(x / 3), SHAPE).astype(np.float32).reshape(-1)


def together(pictures: Iterable[Floats32]) -> Floats32:
    return np.array([*pictures], np.float32)


@pytest.mark.parametrize("changed", [2, 5, 8])
def test_a_change_is_located(changed: int) -> None:
    moment = time_of_change(together(picture(number >= changed) for number in range(10)), 4, STRIPES)
    assert moment is not None
    assert (moment.before, moment.after) == (tuple(range(changed)), tuple(range(changed, 10)))
    assert 1.3 < moment.gained < 20


def test_a_picture_taken_during_the_change() -> None:
    pictures = [picture(number >= 5) for number in range(10)]
    pictures[5] = np.float32(0.5) * (picture(0) + picture(1))
    moment = time_of_change(together(pictures), 4, STRIPES)
    assert moment is not None
    assert moment.done[5] == pytest.approx(0.5, abs=0.05)
    assert (moment.before, moment.after) == ((0, 1, 2, 3, 4), (6, 7, 8, 9))


def test_a_uniform_picture_gives_no_change() -> None:
    moment = time_of_change(np.full((6, 3072), 100, np.float32), 3, STRIPES[:6])
    assert moment is not None
    assert moment.gained < 1.3


@pytest.mark.parametrize("narrow", [1.0, 2.0, 4.0])
def test_differences_between_stripe_widths_are_not_taken_for_a_change(narrow: float) -> None:
    assert time_of_change(together(picture(width <= narrow) for width in STRIPES), 5, STRIPES) is None


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_frames_are_added_up_over_squares_of_pixels(scale: int) -> None:
    rng = np.random.default_rng(scale)
    frames = rng.integers(0, 256, (4, 3 + 5 * scale, 2 + 7 * scale)).astype(np.uint8)
    weights = np.array([0.5, 0.25], np.float32) / np.float32(scale**2)
    picture = np.zeros((5, 7), np.float32)
    _add_up(frames, np.array([3, 1]), weights, (3, 2), scale, picture)
    mean = (0.5 * frames[3] + 0.25 * frames[1])[3:, 2:].reshape(5, scale, 7, scale).mean(axis=(1, 3))
    assert np.ptp(mean) > 10
    np.testing.assert_allclose(picture, mean, rtol=1e-5)
