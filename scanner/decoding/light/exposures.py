"""Lit and clipped pixels, and frames of one pattern at several exposures, merged into one image before decoding.

Codes and phases of a pixel do not depend on its brightness. The mosaic of a raw colour image, in which every second
pixel is brighter, matters only where neighbours are compared; so does the exposure of a merged pixel.

Each camera pixel takes all its frames from one exposure, the longest in which white does not saturate it. Its frames
are therefore comparable, and the camera's response need not be known. Frames of equal exposure are averaged.
"""

from collections.abc import Sequence
from math import inf
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import ENOUGH_PIXELS, SIGMA_PER_MEDIAN, Bools, Floats32, Image, evenly_spread, quantile
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS, HALF
from scanner.errors import InputError
from scanner.patterns import Pattern, White

# Pixels whose swing is less than this share of the brightest ones' are not lit: a Lambertian surface at 75° still is.
# Outside the picture, stray light and a camera's automatic tone mapping show the patterns as well.
LIT = 0.25
# Full scales of 10, 12, 14 and 16 bits in a 16-bit image, aligned low or high.
_FULL_SCALES = tuple(((1 << bits) - 1) << shift for bits in (10, 12, 14, 16) for shift in {0, 16 - bits})
# JPEG spreads clipped pixels over the last two levels.
_CLIPPED_8_BIT = 254.0
BAYER_PX = 2  # to the next pixel of the same colour


def lit_by(swing: Floats32) -> NDArray[np.intp]:
    """Return ascending indices of some lit pixels, from the swing (P,) of each."""
    return evenly_spread(np.flatnonzero(swing >= LIT * quantile(swing, BRIGHTEST)))


def unclipped(levels: NDArray[Any], saturation: float) -> NDArray[np.intp]:
    """Return ascending indices of some lit pixels that stay below `saturation` in all frames, levels (frames, P)."""
    swing = np.ptp(levels, axis=0).astype(np.float32)
    lit = lit_by(swing)
    usable: Bools = (swing[lit] > 0) & (levels[:, lit].max(axis=0) < saturation)
    return lit[usable]


def saturation_level(*images: Image) -> float:
    """Return the lowest clipped level of images that have the largest grey levels of a capture; infinity if nothing is
    clipped.

    The bit depth within a 16-bit image is not recorded, but clipped pixels have exactly the largest number of its bits.
    """
    if images[0].dtype == np.uint8:
        return _CLIPPED_8_BIT
    top = max(int(image.max()) for image in images)
    return float(top) if top in _FULL_SCALES else inf


def log_mosaic(lit: Image) -> Floats32 | None:
    """Return the log brightness (H, W) of each pixel's filter, from the fully lit scene; None without a mosaic."""
    down, across = (size // BAYER_PX for size in lit.shape)
    parts = lit[: down * BAYER_PX, : across * BAYER_PX].reshape(down, BAYER_PX, across, BAYER_PX)
    blocks = parts[:: max(1, down * across // ENOUGH_PIXELS)].swapaxes(1, 2).reshape(-1, BAYER_PX**2)
    mean = blocks.mean(axis=1)
    blocks = blocks[mean > LIT * np.quantile(mean, BRIGHTEST)]
    if len(blocks) < FEWEST_PIXELS:
        return None
    logs = np.log(np.maximum(blocks, 1).astype(np.float32))
    logs -= logs.mean(axis=1, keepdims=True)
    of_filters = np.median(logs, axis=0)
    spread = SIGMA_PER_MEDIAN * np.median(np.abs(logs - of_filters), axis=0)
    differ = float(np.ptp(of_filters))
    if differ < FEW or float(spread.max()) > HALF * differ:
        return None
    repeats = (-(-size // BAYER_PX) for size in lit.shape)
    whole = np.tile(of_filters.reshape(BAYER_PX, BAYER_PX), tuple(repeats))
    return whole[: lit.shape[0], : lit.shape[1]].astype(np.float32)


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
