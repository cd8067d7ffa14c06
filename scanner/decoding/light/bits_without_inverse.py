"""Threshold of a bit without an inverse, from the brightness of its frame relative to white and black.

Half-way between white and black is right for steady light. Flicker, ambient light changes, and fine stripes that lose
light change the two levels of a bit; the right threshold is half-way between these. Both are fitted over many pixels:
dark I = a B + l (W − B), or lit I = a B + u (W − B), with a, l and u common to the frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, Floats32, Image, median, robust_sigma
from scanner.decoding.light.lit_pixels import lit_by
from scanner.decoding.significance import FEW, FEWEST_PIXELS, HUBER_ROUNDS, MAJORITY, SIGNIFICANT_SIGMAS

# Levels are alike up to this share of white minus black: a threshold and the one half-way, or white in several bits.
_ALIKE = 0.05
# Quantiles of a bit's levels in its dark and in its bright stripes: blurred edges and interreflection are in between.
TAILS = (0.05, 0.95)


@dataclass(frozen=True)
class BitLevels:
    """Levels of a bit in its frame: I = of_black · black + (dark or bright) · (white − black)."""

    of_black: float
    """Share of black."""
    dark: float
    """Share of white minus black where the bit is 0."""
    bright: float
    """The same where it is 1."""
    away: float
    """Distance of the half-way level from that of white and black, in the same unit."""

    def threshold(self, half_lit: Image, white: Image) -> Image:
        """Return the threshold from half-way level and white, (H, W); the half-way level itself if
        it is close enough.
        """
        if self.away < _ALIKE:
            return half_lit
        of_white = self.dark + self.bright - self.of_black
        return cast(Image, cv2.addWeighted(half_lit, self.of_black - of_white, white, of_white, 0))


def levels_of_bit(frame: Image, half_lit: Image, white: Image) -> BitLevels | None:
    """Fit the levels of a frame, given the half-way level and white, at pixels of a sample (P,).

    None if too few pixels have either level, or the levels are not distinct.
    """
    level, half_way, brightest = (image.astype(np.float32) for image in (frame, half_lit, white))
    lit = lit_by(brightest - half_way)
    half = np.maximum((brightest - half_way)[lit], np.float32(0.5))
    relative, black = level[lit] / (2 * half), (half_way[lit] - half) / (2 * half)
    is_bright = relative - black > np.mean(np.quantile(relative - black, TAILS))
    for _ in range(HUBER_ROUNDS):
        if min(np.count_nonzero(is_bright), np.count_nonzero(~is_bright)) < FEWEST_PIXELS:
            return None
        of_black, dark, bright = _parts(relative, black, is_bright)
        threshold = of_black * black + (dark + bright) / 2
        is_bright = relative > threshold
    off = relative - of_black * black - np.where(is_bright, bright, dark)
    if bright - dark < SIGNIFICANT_SIGMAS * robust_sigma(off):  # not two levels
        return None
    return BitLevels(of_black, dark, bright, median(np.abs(threshold - black - 0.5)))


def white_of(bits: Sequence[BitLevels]) -> float:
    """Return the brightness of white in the patterns, relative to white minus black in the white frame.

    1 unless all bits without an inverse agree on a different value, as with a longer exposure of the white frame or a
    projector that dims bright pictures.
    """
    if len(bits) < MAJORITY:
        return 1.0
    whites = np.array([bit.dark + bit.bright for bit in bits])
    white, dark, bright = (float(np.median(n)) for n in (whites, [b.dark for b in bits], [b.bright for b in bits]))
    if robust_sigma(whites - white) > _ALIKE or abs(white - 1) < FEW:
        return 1.0
    # Ambient light raises both levels by as much, but does not separate them by more than white and black.
    is_white = dark * np.sign(white - 1) < FEW * abs(white - 1) or bright - dark > 1 + FEW / 2
    return white if is_white else 1.0


def _parts(relative: Floats32, black: Floats32, is_bright: Bools) -> tuple[float, float, float]:
    """Fit the share of black, and those of white minus black where dark and where bright, by least squares.

    Levels (P,) are relative to white minus black.
    """
    design = np.stack([black, ~is_bright, is_bright], axis=1).astype(np.float64)
    of_black, dark, bright = np.linalg.lstsq(design, relative, rcond=1e-4)[0].tolist()
    return of_black, dark, bright
