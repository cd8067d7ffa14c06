"""Do Gray codes make sense in an order? A first look at few pixels, so that many orders can be tried.

Wrong orders decode to numbers like any others. But in the right one neighbours see neighbouring projector pixels, the
map from camera to projector is not mirrored, and all of it obeys one epipolar geometry.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.errors import InputError
from scanner.importing.layout import Size
from scanner.io import read_image
from scanner.patterns import Axis, Black, Gray, Pattern, White

_ACROSS = 160
# Of the brightness range of well lit pixels: less is not lit. Of a pixel's own: what decides a bit.
_LIT, _DECIDED = 0.2, 0.05
_FEWEST = 200
_FEWEST_DECIDED = 0.3
_FINEST = 2  # bits that a camera may not resolve
_LEAST_OF_EACH = 0.02
# Random codes are a quarter of their range apart, neighbours on a surface hundredths.
_MOST_APART = 0.1
_LEAST_UPRIGHT = 0.65
_LEAST_ON_LINES = 0.6
_MOST_FITTED = 3000


@dataclass(frozen=True)
class Samples:
    """Grey levels (frames, H, W) at a grid of pixels, `camera_px` (H, W, 2); `camera_size` is (width, height)."""

    levels: Floats
    camera_px: Floats
    camera_size: Size

    @cached_property
    def swing(self) -> Floats:
        """(H, W): from the darkest frame to the brightest."""
        swing: Floats = np.ptp(self.levels, axis=0)
        return swing

    @cached_property
    def lit(self) -> Bools:
        """(H, W): pixels that the frames light differently."""
        lit: Bools = self.swing > max(_LIT * float(np.percentile(self.swing, 98)), 1.0)
        return lit


def take_samples(files: Sequence[Path]) -> Samples:
    """Read all frames. Raises InputError if one is no image, or of another size or kind than the first."""
    levels, first = [], None
    for path in files:
        image = read_image(path)
        if first is not None and (image.shape, image.dtype) != (first.shape, first.dtype):
            raise InputError(
                f"{path}: expected an image of the kind of {files[0].name}, {_kind(first)}, found {_kind(image)}"
            )
        first = image if first is None else first
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        step = max(1, image.shape[1] // _ACROSS)
        levels.append(grey[step // 2 :: step, step // 2 :: step].astype(np.float64))
    if first is None:
        raise InputError("no frames")
    height, width = levels[0].shape
    row, column = np.mgrid[:height, :width]
    camera_px = np.stack([column, row], axis=-1) * float(step) + step // 2
    return Samples(np.stack(levels), camera_px, (first.shape[1], first.shape[0]))


def _kind(image: np.ndarray) -> str:
    colours = "colour" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]}, {8 * image.itemsize}-bit {colours}"


@dataclass(frozen=True)
class Codes:
    """Cell numbers (H, W) along an axis, and at which pixels they are certain, but for the finest bits."""

    numbers: Floats
    certain: Bools


def objection(samples: Samples, patterns: Sequence[Pattern]) -> str | None:
    """Why the frames cannot be these patterns, in a few words; None if they may be. Fringes are not looked at."""
    levels, lit = samples.levels, samples.lit
    if np.count_nonzero(lit) < _FEWEST:
        return "the frames hardly differ"
    known = {type(p): levels[index] for index, p in enumerate(patterns) if isinstance(p, White | Black)}
    if White in known and Black in known:
        contrast = (known[White] - known[Black])[lit] / samples.swing[lit]
        if np.median(contrast) < 0.5:
            return "the white frame is not brighter than the black one"
    found: dict[Axis, Codes] = {}
    for axis in ("x", "y"):
        codes = _codes(samples, patterns, axis, known)
        if isinstance(codes, str):
            return codes
        if codes is not None:
            found[axis] = codes
    return _scattered(found) or _nonsense(samples, found)


def _codes(samples: Samples, patterns: Sequence[Pattern], axis: Axis, known: dict[type, Floats]) -> Codes | str | None:
    """The codes of an axis, None if it has none, or what is wrong with them."""
    shown = {(p.bit, p.inverted): index for index, p in enumerate(patterns) if isinstance(p, Gray) and p.axis == axis}
    if not shown:
        return None
    bits = max(p.bits for p in patterns if isinstance(p, Gray) and p.axis == axis)
    levels, lit = samples.levels, samples.lit
    middle = (known[White] + known[Black]) / 2 if len(known) == 2 else (levels.min(axis=0) + levels.max(axis=0)) / 2
    number, certain, before = np.zeros(lit.shape), lit.copy(), np.zeros(lit.shape, np.bool_)
    for bit in range(bits):
        normal, inverse = shown.get((bit, False)), shown.get((bit, True))
        bright = middle if normal is None else levels[normal]
        dark = middle if inverse is None else levels[inverse]
        one, decided = bright > dark, np.abs(bright - dark) > _DECIDED * samples.swing
        if bit < bits - _FINEST:
            certain &= decided
        elif bit == bits - 1 and min(np.mean(one[lit & decided]), np.mean(~one[lit & decided])) < _LEAST_OF_EACH:
            return f"the finest bit of {axis} never changes"
        before ^= one
        number = 2 * number + before
    if np.count_nonzero(certain) < max(_FEWEST, _FEWEST_DECIDED * np.count_nonzero(lit)):
        return f"the bits of {axis} are neither bright nor dark at {1 - certain.sum() / lit.sum():.0%} of the pixels"
    return Codes(number, certain)


def _scattered(found: dict[Axis, Codes]) -> str | None:
    for axis, codes in found.items():
        spread = float(np.ptp(np.percentile(codes.numbers[codes.certain], (5, 95))))
        steps = np.concatenate([np.abs(after - before) for before, after in _beside(codes.numbers, codes.certain)])
        if not len(steps) or np.median(steps) > max(_MOST_APART * spread, 1.0):
            return f"neighbouring pixels have unrelated codes in {axis}"
    return None


def _nonsense(samples: Samples, found: dict[Axis, Codes]) -> str | None:
    if len(found) < 2:
        return None
    x, y = found["x"], found["y"]
    both = x.certain & y.certain
    if np.count_nonzero(both) < _FEWEST:
        return "too few pixels have both codes"
    upright = _upright(x.numbers, y.numbers, both)
    if upright < _LEAST_UPRIGHT:
        return f"the codes are mirrored at {1 - upright:.0%} of the pixels"
    on_lines = share_on_epipolar_lines(samples.camera_px[both], np.stack([x.numbers[both], y.numbers[both]], axis=1))
    if on_lines < _LEAST_ON_LINES:
        return f"only {on_lines:.0%} of the pixels obey one epipolar geometry"
    return None


def _beside(numbers: Floats, there: Bools) -> list[tuple[Floats, Floats]]:
    """Numbers of pixels beside each other, and one above the other."""
    right, below = there[:, :-1] & there[:, 1:], there[:-1] & there[1:]
    return [(numbers[:, :-1][right], numbers[:, 1:][right]), (numbers[:-1][below], numbers[1:][below])]


def _upright(x: Floats, y: Floats, there: Bools) -> float:
    """At which share of the pixels the map to the projector turns the same way round, of those where it shows."""
    inner = there[:-1, :-1] & there[:-1, 1:] & there[1:, :-1]
    turn = np.diff(x, axis=1)[:-1] * np.diff(y, axis=0)[:, :-1] - np.diff(y, axis=1)[:-1] * np.diff(x, axis=0)[:, :-1]
    turning = turn[inner & (turn != 0)]
    return float(np.mean(turning > 0)) if len(turning) else 0.0


def share_on_epipolar_lines(camera_px: Floats, projector_px: Floats, within_px: float = 4.0) -> float:
    """The share of matches (N, 2) that are near the epipolar lines of one fundamental matrix, lenses left aside."""
    chosen = np.random.default_rng(0).permutation(len(camera_px))[:_MOST_FITTED]
    cv2.setRNGSeed(0)
    _, near = cv2.findFundamentalMat(camera_px[chosen], projector_px[chosen], cv2.USAC_MAGSAC, within_px, 0.999, 2000)
    return 0.0 if near is None else float(np.mean(near > 0))
