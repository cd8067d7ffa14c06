"""Fold the frames of a fringe into its two components as they arrive."""

from typing import Any

import cv2
import numpy as np

from calib.numerics import Image, compiled
from scanner.decoding.arrays import Component
from scanner.decoding.light.equalise import Correction
from scanner.decoding.sequence_plan import Fringe


class FringeFold:
    """The two components A cos θ and A sin θ of a fringe, (H, W) each, by least squares over its shifts.

    `cosine` and `sine` times `scale` are in grey levels, to which `correction` applies if there is one. For four equal
    shifts each is the integer difference of two frames, of which the first waits for the second. Otherwise they are
    weighted sums.
    """

    def __init__(self, fringe: Fringe, shape: tuple[int, int], dtype: np.dtype[Any], waiting: dict[int, Image]) -> None:
        self.fringe = fringe
        weights = fringe.weights[1:]
        largest = float(np.abs(weights).max())
        self._signs = np.rint(weights / largest).astype(np.int64)
        opposite = all(sorted(signs) == [-1, 0, 0, 1] for signs in self._signs.tolist())
        self._is_plain = opposite and bool(np.allclose(self._signs * largest, weights, atol=1e-9))
        self._waiting = waiting
        self.scale = largest if self._is_plain else 1.0
        self.correction: Correction | None = None
        # Differences overwrite, sums accumulate from zero.
        begin = np.empty if self._is_plain else np.zeros
        kept_as = np.dtype(np.float32) if not self._is_plain else np.dtype(np.int16 if dtype == np.uint8 else np.int32)
        self.cosine: Component = begin(shape, kept_as)
        self.sine: Component = begin(shape, kept_as)

    def fold(self, step: int, frame: Image, peak: Image) -> None:
        """Add the frame of one shift, and update `peak` (H, W) with it; a waiting frame is included when it is
        subtracted.
        """
        if not self._is_plain:
            np.maximum(peak, frame, out=peak)
            for component, weights in zip((self.cosine, self.sine), self.fringe.weights[1:], strict=True):
                cv2.addWeighted(component, 1, frame, float(weights[step]), 0, dst=component, dtype=cv2.CV_32F)
            return
        number = int(np.flatnonzero(self._signs[:, step])[0])
        opposite = int(np.flatnonzero(self._signs[number] == -self._signs[number, step])[0])
        other = self._waiting.pop(self.fringe.frames[opposite], None)
        if other is None:
            self._waiting[self.fringe.frames[step]] = frame
            return
        component, sign = (self.cosine, self.sine)[number], int(self._signs[number, step])
        _subtract(frame.reshape(-1), other.reshape(-1), sign, component.reshape(-1), peak.reshape(-1))


@compiled
def _subtract(frame: Image, other: Image, sign: int, difference: Component, peak: Image) -> None:
    """Subtract two frames, with a sign, and update the peaks with both; (P,)."""
    for i in range(len(frame)):
        difference[i] = sign * (np.int32(frame[i]) - np.int32(other[i]))
        peak[i] = max(peak[i], max(frame[i], other[i]))
