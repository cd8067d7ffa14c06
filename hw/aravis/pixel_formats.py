"""Decodes the bytes of a GenICam pixel format to an image (GenICam Pixel Format Naming Convention, version 2.4).

Grey levels are not scaled: 12 bits become the numbers 0 to 4095 in 16-bit pixels.
"""

import re
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image

Bytes = NDArray[np.uint8]

# 'p' packs little-endian without gaps; 'Packed' is GigE Vision's older way: two pixels in three bytes.
_NAME = re.compile(r"(Mono|BayerRG|BayerGR|BayerGB|BayerBG|RGB|BGR)(8|10|12|14|16)(p|Packed)?")
_BAYER = {
    "BayerRG": cv2.COLOR_BayerRGGB2BGR,
    "BayerGR": cv2.COLOR_BayerGRBG2BGR,
    "BayerGB": cv2.COLOR_BayerGBRG2BGR,
    "BayerBG": cv2.COLOR_BayerBGGR2BGR,
}
_COLOURS = ("RGB", "BGR")


@dataclass(frozen=True)
class PixelFormat:
    """A pixel format: `kind` as in its name, `bits` per channel, and their packing."""

    kind: str
    bits: int
    packing: Literal["", "p", "Packed"]

    @property
    def channels(self) -> int:
        """Numbers per pixel."""
        return 3 if self.kind in _COLOURS else 1

    @property
    def bits_stored(self) -> int:
        """Bits of one number in the camera's data, padding included."""
        if self.packing == "":
            return 8 if self.bits == 8 else 16
        return 12 if self.packing == "Packed" else self.bits

    def image(self, data: bytes, width: int, height: int) -> Image:
        """(H, W) grey, or (H, W, 3) in the order blue, green, red; uint8 or uint16.

        Raises ValueError if there are too few bytes.
        """
        needed = -(-width * height * self.channels * self.bits_stored // 8)
        if len(data) < needed:
            raise ValueError(f"an image of {width} × {height} in {self} has {needed} bytes, found {len(data)}")
        numbers = self._numbers(np.frombuffer(data, np.uint8, needed), width * height * self.channels)
        if self.kind in _BAYER:
            return _as_image(cv2.cvtColor(numbers.reshape(height, width), _BAYER[self.kind]))
        if self.kind in _COLOURS:
            pixels = numbers.reshape(height, width, 3)
            return _as_image(pixels if self.kind == "BGR" else pixels[:, :, ::-1])
        return numbers.reshape(height, width)

    def _numbers(self, data: Bytes, count: int) -> Image:
        if self.packing == "":
            return data if self.bits == 8 else data.view("<u2").astype(np.uint16)
        if self.packing == "Packed":
            return _unpack_gige(data, self.bits, count)
        return _unpack(data, self.bits, count)

    def __str__(self) -> str:
        return f"{self.kind}{self.bits}{self.packing}"


def pixel_format(name: str) -> PixelFormat:
    """The format with this GenICam name. Raises ValueError if it is not supported."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"the pixel format {name!r} is not known: use Mono or Bayer with 8, 10, 12, 14 or 16 bits")
    kind, bits, packing = match[1], int(match[2]), match[3] or ""
    if (packing == "Packed" and bits not in (10, 12)) or (packing == "p" and bits not in (10, 12, 14)):
        raise ValueError(f"the pixel format {name!r} is not known: only 10 and 12 bits are packed")
    return PixelFormat(kind, bits, packing)  # type: ignore[arg-type]  # the pattern allows no other packing


def _as_image(pixels: NDArray[Any]) -> Image:
    """The same pixels in a contiguous array."""
    return np.ascontiguousarray(pixels)


def _unpack(data: Bytes, bits: int, count: int) -> Image:
    """Numbers of `bits` bits without gaps, the least significant bit first."""
    padded = np.concatenate([data, np.zeros(4, np.uint8)])
    first_bit = np.arange(count, dtype=np.int64) * bits
    byte, shift = first_bit >> 3, (first_bit & 7).astype(np.uint32)
    window = padded[byte].astype(np.uint32)
    for k in (1, 2):
        window |= padded[byte + k].astype(np.uint32) << np.uint32(8 * k)
    return _as_image(((window >> shift) & np.uint32((1 << bits) - 1)).astype(np.uint16))


def _unpack_gige(data: Bytes, bits: int, count: int) -> Image:
    """Two numbers in three bytes: the high eight bits of each outside, the low bits of both in the middle."""
    triples = np.concatenate([data, np.zeros(-len(data) % 3, np.uint8)]).reshape(-1, 3).astype(np.uint16)
    low_bits = bits - 8
    mask = np.uint16((1 << low_bits) - 1)
    numbers = np.empty((len(triples), 2), np.uint16)
    numbers[:, 0] = (triples[:, 0] << low_bits) | (triples[:, 1] & mask)
    numbers[:, 1] = (triples[:, 2] << low_bits) | ((triples[:, 1] >> 4) & mask)
    return _as_image(numbers.reshape(-1)[:count])
