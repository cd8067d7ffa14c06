"""Verification by complementary sums, in frames with noise, blur and an uneven scene."""

import numpy as np
import pytest

from hw.timing.redundancy import ComplementarySums, complementary_sums

SIZE = (60, 80)
STRIPES = [16, 8, 4, 32]


def picture(width: int) -> np.ndarray:
    row = np.where(np.arange(SIZE[1]) // width % 2, 255, 0).astype(np.uint8)
    return np.broadcast_to(row, SIZE).copy()


def series() -> list[np.ndarray]:
    """White, black, and stripes of several widths, each followed by its inverse."""
    pictures = [np.full(SIZE, 255, np.uint8), np.zeros(SIZE, np.uint8)]
    return pictures + [each for width in STRIPES for each in (picture(width), 255 - picture(width))]


class Scene:
    """Uneven albedo, and a tenth of all light as uniform interreflection."""

    def __init__(self, noise: float) -> None:
        self._rng = np.random.default_rng(0)
        self._reflects = 60 + 120 * self._rng.random(SIZE)
        self._noise = noise

    def frame(self, shown: np.ndarray) -> np.ndarray:
        light = self._reflects * (0.9 * shown / 255 + 0.1 * shown.mean() / 255) + 8
        return (light + self._noise * self._rng.standard_normal(SIZE)).clip(0, 255).astype(np.uint8)

    def sums(self) -> ComplementarySums:
        dark, bright = ([self.frame(np.full(SIZE, level, np.uint8)) for _ in range(3)] for level in (0, 255))
        return complementary_sums(dark, bright, np.ones(SIZE, bool), 0.005)


def foreign(shown: list[np.ndarray], group: tuple[int, int], noise: float = 1.5) -> tuple[float, float]:
    """The foreign share found in a group of `series` if the projector shows other pictures, and the tolerance."""
    scene = Scene(noise)
    sums = scene.sums()
    seen = {number: sums.brightness(scene.frame(each)) for number, each in enumerate(shown)}
    beside = {number: (number - 1, number + 1) for number in group}
    return sums.foreign_share(group, [series()[number] for number in group], seen, beside), sums.tolerance


@pytest.mark.parametrize("noise", [0.5, 2.0, 6.0])
@pytest.mark.parametrize("first", range(0, 10, 2))
def test_sums_of_correct_frames_are_level(first: int, noise: float) -> None:
    found, tolerance = foreign(series(), (first, first + 1), noise)
    assert found < tolerance < 0.1


@pytest.mark.parametrize(
    ("number", "towards"),
    [(number, towards) for number in range(10) for towards in (-1, 1) if 0 <= number + towards < 10],
)
@pytest.mark.parametrize("share", [0.04, 0.2, 0.6, 1.0])
def test_a_share_of_a_neighbouring_picture_is_detected(number: int, towards: int, share: float) -> None:
    right = series()
    shown = list(right)
    shown[number] = (1 - share) * right[number] + share * right[number + towards]
    first = number - number % 2
    found, tolerance = foreign(shown, (first, first + 1))
    assert found > tolerance
    assert found < 1.5


@pytest.mark.parametrize("behind", [1, 2, 3])
def test_a_delayed_display_is_located(behind: int) -> None:
    """One picture stays too long, and all that follow are late by as many frames."""
    for start in range(1, 8):
        right = series()
        shown = right[:start] + [right[start - 1]] * behind + right[start:]
        found = [foreign(shown[:10], (first, first + 1)) for first in (start - start % 2, start + start % 2)]
        assert any(share > tolerance for share, tolerance in found)


def steps(count: int, period: float = 10.0, response: float = 1.0) -> list[np.ndarray]:
    """Steps of a fringe on a projector with this gamma."""
    turns = np.arange(SIZE[1]) / period
    waves = [0.5 + 0.5 * np.cos(2 * np.pi * (turns + step / count)) for step in range(count)]
    return [np.broadcast_to(255 * wave**response, SIZE) for wave in waves]


def found_in_steps(shown: list[np.ndarray]) -> tuple[float, float]:
    """The foreign share found in successive steps, and the tolerance."""
    scene = Scene(1.5)
    sums, group = scene.sums(), range(len(shown))
    seen = {number: sums.brightness(scene.frame(each)) for number, each in enumerate(shown)}
    beside = {number: (number - 1, number + 1) for number in group}
    return sums.foreign_share(group, [each.astype(np.uint8) for each in shown], seen, beside), sums.tolerance


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("response", [1.0, 2.2])
def test_sums_of_correct_fringe_steps_are_level(count: int, response: float) -> None:
    found, tolerance = found_in_steps(steps(count, response=response))
    assert found < tolerance


@pytest.mark.parametrize("response", [1.0, 2.2])
@pytest.mark.parametrize("share", [0.3, 0.45, 0.8])
@pytest.mark.parametrize("count", [4, 6])
def test_equally_late_opposite_steps_are_detected(count: int, share: float, response: float) -> None:
    """Their sum is as level as that of correct ones."""
    shown = right = steps(count, response=response)
    for late in (1, 1 + count // 2):
        shown = [*shown[:late], (1 - share) * right[late] + share * right[late - 1], *shown[late + 1 :]]
    found, tolerance = found_in_steps(shown)
    assert max(tolerance, 0.3 * share) < found < 1.5 * share


def test_a_change_between_two_takes_of_white_and_black_is_measured() -> None:
    """White and black differ only in level."""
    scene = Scene(1.5)
    sums = scene.sums()
    white, black = series()[:2]
    right = {0: sums.brightness(scene.frame(white)), 1: sums.brightness(scene.frame(black))}
    late = {**right, 1: sums.brightness(scene.frame(0.36 * white + 0.64 * black))}
    beside = {0: (1,), 1: (0,)}
    assert sums.changed_share((0, 1), [white, black], right, late, beside) == pytest.approx(0.36, abs=0.02)
    assert sums.changed_share((0, 1), [white, black], late, late, beside) == 0.0


def test_colour_frames_are_checked_as_grey() -> None:
    image = np.arange(60 * 80 * 3, dtype=np.uint16).reshape(60, 80, 3)
    sums = complementary_sums([image * 0] * 3, [image * 0 + 100] * 3, np.ones(SIZE, bool), 0.005)
    np.testing.assert_allclose(sums.brightness(image), image.mean(axis=2)[sums.pixels] / 100)
