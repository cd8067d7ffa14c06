"""The parity check of bits without inverses, in a scene with noise and interreflection."""

import numpy as np
import pytest

from hw.rig import Redundancy
from hw.timing.redundancy import complementary_sums, mixed_share, odd_share, with_parity
from scanner.patterns import draw, gray_sequence

SIZE = (160, 120)
BITS = [draw(bit, SIZE) for bit in gray_sequence("x", SIZE[0], 8, inverses=False)]


class Scene:
    """Uneven albedo, and interreflection that is strongest at its right side."""

    def __init__(self, noise: float) -> None:
        self._rng = np.random.default_rng(0)
        self._noise = noise
        self._reflects = 60 + 120 * self._rng.random(SIZE[::-1])
        self._bounces = np.linspace(0.05, 0.4, SIZE[0])

    def seen(self, shown: list[np.ndarray]) -> dict[int, np.ndarray]:
        black, white = (np.full(SIZE[::-1], level, np.uint8) for level in (0, 255))
        dark, bright = ([self._frame(each) for _ in range(3)] for each in (black, white))
        sums = complementary_sums(dark, bright, _LIT, 0.005)
        return {number: sums.brightness(self._frame(picture)) for number, picture in enumerate(shown)}

    def _frame(self, shown: np.ndarray) -> np.ndarray:
        light = (1 - self._bounces) * shown / 255 + self._bounces * shown.mean() / 255
        noise = self._noise * self._rng.standard_normal(SIZE[::-1])
        return (self._reflects * light + 8 + noise).clip(0, 255).astype(np.uint8)


_LIT = np.ones(SIZE[::-1], bool)
_TOLERANCE = 0.03


def test_a_group_lights_every_pixel_an_even_number_of_times() -> None:
    white, black = np.full(SIZE[::-1], 255, np.uint8), np.zeros(SIZE[::-1], np.uint8)
    series = with_parity(iter([white, black, *BITS, white]), Redundancy([(0, 1)], [tuple(range(2, 2 + len(BITS)))]))
    images = list(series.images)
    assert len(images) == len(BITS) + 4
    assert series.level == ((0, 1),)
    (group,) = series.even
    assert series.added == {2} == {group[0]}
    assert not np.any(np.sum([images[number] > 0 for number in group], axis=0) % 2)
    for number, bit in zip(group[1:], BITS, strict=True):
        np.testing.assert_array_equal(images[number], bit)


@pytest.mark.parametrize("late", range(len(BITS)))
@pytest.mark.parametrize("for_good", [False, True])
def test_frames_of_wrong_pictures_fail_the_parity_check(late: int, for_good: bool) -> None:
    """One picture is shown too long, and all that follow may be late, too."""
    right = list(with_parity(iter(BITS), Redundancy(unpaired=[tuple(range(len(BITS)))])).images)
    scene = Scene(3.0)
    assert odd_share(range(len(right)), scene.seen(right)) < 0.002
    shown = right[: late + 1] + [right[late]] + (right[late + 1 : -1] if for_good else right[late + 2 :])
    assert len(shown) == len(right)
    assert 0.3 < odd_share(range(len(right)), scene.seen(shown)) < 0.7


def test_uniformly_grey_frames_verify_nothing() -> None:
    seen = {number: np.full(1000, 0.5) for number in range(3)}
    assert odd_share([0, 1, 2], seen) == 1.0


@pytest.mark.parametrize("number", range(1, len(BITS) - 1))
@pytest.mark.parametrize("towards", [-1, 1])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.2, 0.4])
def test_a_share_of_a_neighbouring_picture_is_measured(number: int, towards: int, share: float) -> None:
    shown = [bit.astype(float) for bit in BITS]
    shown[number] = (1 - share) * shown[number] + share * shown[number + towards]
    seen = Scene(2.0).seen(shown)
    found = mixed_share(seen[number], [seen[number - 1], seen[number + 1]], _TOLERANCE)
    assert found == pytest.approx(share, abs=0.02)


def test_pictures_without_edges_verify_nothing() -> None:
    seen = Scene(2.0).seen([*BITS[:2], np.zeros(SIZE[::-1])])
    assert mixed_share(seen[1], [seen[0], seen[2]], _TOLERANCE) is None
    assert mixed_share(seen[1], [], _TOLERANCE) is None
