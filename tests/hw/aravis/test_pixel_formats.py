"""Bytes of a camera, packed here bit by bit, give the original numbers."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import DTypeLike

from hw.aravis.pixel_formats import pixel_format


def packed_bits(numbers: np.ndarray, bits: int) -> bytes:
    """One number after the other, least significant bit first (PFNC 'p')."""
    stream = sum(int(number) << (bits * index) for index, number in enumerate(numbers.ravel()))
    return stream.to_bytes(-(-numbers.size * bits // 8), "little")


def packed_gige(numbers: np.ndarray, bits: int) -> bytes:
    """Two numbers in three bytes: high, both lows, high (GigE Vision 'Packed')."""
    flat = [*map(int, numbers.ravel()), 0]
    low = bits - 8
    mask = (1 << low) - 1
    pairs = zip(flat[::2], flat[1::2], strict=False)
    data = b"".join(bytes([a >> low, (a & mask) | ((b & mask) << 4), b >> low]) for a, b in pairs)
    return data[: -(-numbers.size * 12 // 8)]


@pytest.mark.parametrize("bits", [10, 12, 14])
@given(width=st.integers(1, 9), height=st.integers(1, 5), seed=st.integers(0, 99))
def test_packed_formats(bits: int, width: int, height: int, seed: int) -> None:
    numbers = np.random.default_rng(seed).integers(0, 1 << bits, (height, width)).astype(np.uint16)
    image = pixel_format(f"Mono{bits}p").image(packed_bits(numbers, bits), width, height)
    np.testing.assert_array_equal(image, numbers)
    if bits != 14:
        image = pixel_format(f"Mono{bits}Packed").image(packed_gige(numbers, bits), width, height)
        np.testing.assert_array_equal(image, numbers)


@pytest.mark.parametrize(
    ("name", "kind"), [("Mono8", np.uint8), ("Mono10", "<u2"), ("Mono12", "<u2"), ("Mono16", "<u2")]
)
def test_plain_formats(name: str, kind: DTypeLike) -> None:
    numbers = np.arange(12).reshape(3, 4).astype(kind)
    image = pixel_format(name).image(numbers.tobytes() + b"padding", 4, 3)
    np.testing.assert_array_equal(image, numbers)
    assert image.dtype in (np.uint8, np.uint16)


@pytest.mark.parametrize("order", ["RG", "GR", "GB", "BG"])
@pytest.mark.parametrize("bits", ["8", "12", "12p"])
def test_bayer_formats_give_the_colour_that_fell_on_the_sensor(order: str, bits: str) -> None:
    blue, green, red = colour = (40, 90, 200)
    levels = {"R": red, "G": green, "B": blue}
    rows = order + {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}[order]
    mosaic = np.tile(np.array([levels[name] for name in rows]).reshape(2, 2), (4, 5)).astype(np.uint16)
    data = {"8": mosaic.astype(np.uint8).tobytes(), "12": mosaic.tobytes(), "12p": packed_bits(mosaic, 12)}[bits]
    image = pixel_format(f"Bayer{order}{bits}").image(data, 10, 8)
    assert image.shape == (8, 10, 3)
    np.testing.assert_array_equal(image[2:-2, 2:-2], np.broadcast_to(colour, (4, 6, 3)))


def test_colour_formats_come_as_blue_green_red() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (3, 4, 3)).astype(np.uint8)
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    np.testing.assert_array_equal(pixel_format("RGB8").image(rgb.tobytes(), 4, 3), bgr)
    np.testing.assert_array_equal(pixel_format("BGR8").image(bgr.tobytes(), 4, 3), bgr)


def test_too_few_bytes_are_refused() -> None:
    with pytest.raises(ValueError, match="4 × 3 in Mono12p has 18 bytes, found 17"):
        pixel_format("Mono12p").image(bytes(17), 4, 3)


@pytest.mark.parametrize("name", ["YUV422_8", "Mono8p", "Mono12packed", "Mono16Packed", "Mono14Packed", "Mono1p", ""])
def test_other_formats_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="is not known"):
        pixel_format(name)
