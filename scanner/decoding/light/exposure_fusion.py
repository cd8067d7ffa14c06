"""Merge frames of one pattern at several exposures into one image, before decoding.

Each camera pixel takes all its frames from one exposure, the longest in which white does not saturate it. Its frames
are therefore comparable, and the camera's response need not be known. The exposure matters only where neighbouring
pixels are compared.

Frames of equal exposure are averaged.
"""

from collections.abc import Sequence
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats32, Image
from scanner.decoding.light.lit_pixels import saturation_level
from scanner.errors import InputError
from scanner.patterns import Pattern, White

# White may reach this share of the camera's range: a fringe, or blur from a brighter neighbour, may exceed it a little.
_MOST = 0.95
# Relative difference up to which exposures are equal, and up to which frames of unknown exposure seem equal.
_SAME, _SEEM_ALIKE = 0.01, 0.15


def exposures_of(patterns: Sequence[Pattern]) -> tuple[tuple[Pattern, ...], int]:
    """Return the patterns without repeats, and the number of successive frames of each; 1 if they differ in number."""
    count = next((n for n, pattern in enumerate(patterns) if pattern != patterns[0]), len(patterns))
    once = tuple(patterns[::count]) if count else ()
    if count > 1 and len(patterns) == count * len(once) and all(p == once[n // count] for n, p in enumerate(patterns)):
        return once, count
    return tuple(patterns), 1


class ExposureMerger:
    """Take `count` frames of each pattern and merge them; the first pattern must be white if exposures differ.

    Raises InputError if it is not: only white shows how bright a pixel becomes.
    """

    def __init__(self, patterns: Sequence[Pattern], count: int) -> None:
        self._white_first = isinstance(patterns[0], White)
        self._count = count
        self._frames: list[tuple[float | None, Image]] = []
        self._exposures_us: list[float] = []
        self._choice: list[NDArray[np.uint8]] | None = None
        self._alike: bool | None = None

    def add(self, name: str, image: Image, exposure_us: float | None) -> Image | None:
        """Return the merged image with the last frame of a pattern, else None; `name` is for messages.

        Raises InputError if the exposures are unknown and seem to differ, or differ from those of the first pattern.
        """
        self._frames.append((exposure_us, image.copy()))
        if len(self._frames) < self._count:
            return None
        frames, self._frames = self._frames, []
        known = [exposure for exposure, _ in frames if exposure is not None]
        if self._alike is None:
            self._alike = self._are_alike(name, frames, known)
        if not self._alike:
            return self._merged(name, frames)
        if known and np.ptp(known) > _SAME * max(known):
            raise InputError(f"{name}: expected one exposure, as of the first pattern, found {_listed(known)}")
        return _mean([image for _, image in frames])

    def _are_alike(self, name: str, frames: Sequence[tuple[float | None, Image]], known: Sequence[float]) -> bool:
        """Whether the frames of the first pattern, some of `known` exposure, were exposed equally."""
        are_unknown = len(known) < self._count
        if are_unknown or np.ptp(known) <= _SAME * max(known):
            means = np.array([float(np.mean(image)) for _, image in frames])
            if np.ptp(means) <= _SEEM_ALIKE * means.max():
                return True
            stated = "but not their exposure_us" if are_unknown else f"their exposures do not: {_listed(known)}"
            raise InputError(
                f"{name}: the capture has several frames of each pattern, which differ in brightness, {stated}"
            )
        if not self._white_first:
            raise InputError(
                f"the capture has {self._count} frames of each pattern; the first pattern must then be white, because "
                "it tells which exposure suits each pixel"
            )
        return False

    def _merged(self, name: str, taken: Sequence[tuple[float | None, Image]]) -> Image:
        frames = sorted(((exposure or 0.0, image) for exposure, image in taken), key=lambda frame: -frame[0])
        exposures_us = [exposure for exposure, _ in frames]
        if self._choice is None:
            self._exposures_us = exposures_us
            self._choice = self._choose([image for _, image in frames])
        if not np.allclose(exposures_us, self._exposures_us, rtol=_SAME) or len(set(exposures_us)) < self._count:
            raise InputError(
                f"{name}: expected exposures that differ and are those of the first pattern, "
                f"{_listed(self._exposures_us)}, found {_listed(exposures_us)}"
            )
        merged = frames[0][1]
        for chosen, (_, image) in zip(self._choice, frames[1:], strict=True):
            cv2.copyTo(image, chosen, merged)
        return merged

    @property
    def log_exposure(self) -> Floats32 | None:
        """(H, W): logarithm of each pixel's exposure relative to the shortest; None if exposures are equal or not yet
        known.
        """
        if self._choice is None:
            return None
        ratios = np.log(np.array(self._exposures_us) / self._exposures_us[-1])
        result = np.full(self._choice[0].shape, ratios[0], np.float32)
        for chosen, ratio in zip(self._choice, ratios[1:], strict=True):
            result[chosen > 0] = ratio
        return result

    def to_shortest_exposure(self, image: Image) -> Image:
        """Scale a merged image to the shortest exposure."""
        log_exposure = self.log_exposure
        if log_exposure is None:
            return image
        factor = np.exp(-log_exposure)
        levels = image * (factor[..., None] if image.ndim == 3 else factor)
        return cast(Image, np.rint(levels).astype(image.dtype))

    def _choose(self, whites: list[Image]) -> list[NDArray[np.uint8]]:
        """Return, for each exposure but the longest, the mask of pixels where it replaces longer ones; (H, W), longest
        first.
        """
        brightest = [white.max(axis=2) if white.ndim == 3 else white for white in whites]
        limit = _MOST * saturation_level(brightest[0])
        return [(white > limit).astype(np.uint8) for white in brightest[:-1]]


def _mean(images: Sequence[Image]) -> Image:
    mean: Image = np.rint(np.mean(images, axis=0)).astype(images[0].dtype)
    return mean


def _listed(exposures_us: Sequence[float]) -> str:
    return " and ".join(f"{exposure:g}" for exposure in exposures_us) + " µs"
