"""The level at which a camera saturates, from the bit depth that its images use."""

import numpy as np
import pytest

from scanner.decoding import saturation_level


@pytest.mark.parametrize(
    ("peak", "level"),
    [(1023, 1023), (4095, 4095), (65535, 65535), (65520, 65520), (4000, np.inf), (900, np.inf)],
)
def test_the_saturation_of_16_bit_images(peak: int, level: float) -> None:
    assert saturation_level(np.array([[3, peak]], np.uint16)) == level


def test_the_saturation_of_8_bit_images() -> None:
    assert saturation_level(np.array([[3, 9]], np.uint8)) == 254
