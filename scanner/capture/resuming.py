"""Taking up a capture that was broken off: the same rig before the same scene shows what is missing.

The scene is the same if two frames of one pattern are: as bright, nothing moved, nothing else in the picture.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Image, huber_weights, robust_sigma
from hw.rig import Frame, Rig
from scanner.capture.recording import Recording
from scanner.capture.stream import Stream, capture
from scanner.errors import InputError
from scanner.io import read_image
from scanner.patterns import Gray, Pattern, Phase, ProjectorResponse, White, Xor

# What a lamp or an exposure that is no whole number of refresh periods does from frame to frame is less.
_MOST_BRIGHTER = 1.25
_MOST_LIGHT_ADDED = 0.2
# Motion that shifts what was taken before against what comes after by less, in projector pixels, is taken back, or does
# no harm; and less than so many camera pixels may be noise.
_MOST_MOVED_PX = 0.3
_NOISE_PX = 0.1
# Of the tiles that show something, so many may differ: noise at edges, somebody's shadow.
_MOST_CHANGED = 0.1
_CHANGED_OF_CONTRAST = 0.25
_TILE_PX = 16
_FEWEST_TILES = 4
_LIT = 0.25  # of the brightest: more than indirect light, less than what walls at a slant send back
_SMOOTHING_PX = 1.0
# White noise loses this factor of its sigma to smoothing, but next to nothing in sums along smooth slopes.
_SMOOTHED = 2 * np.sqrt(np.pi) * _SMOOTHING_PX
_ROUNDS = 10
_BLACK_OF_ALL = 0.02
_LEAST_GAIN = 1e-3
_MOST_PIXELS = 200_000
# A tile tells of motion if noise moves it by less than this.
_SURE_PX = 0.1
# What differs from start to start of one and the same rig.
_MEASURED = {"light after a flip"}


@dataclass(frozen=True)
class FrameComparison:
    """`gain` and `offset` (in contrasts) make the first frame as bright as the second; `moved_px`: by how much stripes
    and edges lie elsewhere, across them, in the median, None where there are none; `changed`: the share of tiles that
    differ all the same.
    """

    gain: float
    offset: float
    moved_px: float | None
    changed: float


def refuse_another_scene(what: str, before: Image, now: Image, scale: float = 1.0) -> None:
    """Raise InputError, naming what is not as it was, if two frames (H, W[, 3]) of what was `shown` differ.

    `scale`: about how many camera pixels wide a projector pixel is.
    """
    change = compare(before, now)
    if change.moved_px is not None and change.moved_px > max(_MOST_MOVED_PX * scale, _NOISE_PX):
        said = f"it is shifted by {change.moved_px:.2g} camera px: camera, projector or scene have moved"
    elif change.changed > _MOST_CHANGED:
        said = f"{change.changed:.0%} of the picture show something else: something was moved, added or removed"
    elif not 1 / _MOST_BRIGHTER < change.gain < _MOST_BRIGHTER:
        said = f"it is {change.gain:.2f} times as bright: exposure, aperture, lamp or the projector's mode were changed"
    elif abs(change.offset) > _MOST_LIGHT_ADDED:
        said = "the light in the room, beside the projector's, is not as it was"
    else:
        return
    raise InputError(
        f"the capture cannot be resumed: {what} was shown again, and {said}. Put it back as it was and try again, or "
        "capture anew"
    )


def compare(before: Image, now: Image) -> FrameComparison:
    """Least squares in small tiles: what of the difference is motion, what is left."""
    first, second = _grey(before), _grey(now)
    low, high = np.percentile(first, [2, 98])
    contrast = max(float(high - low), 1e-6)
    gain, offset = _brightness(first, second)
    smooth = cv2.GaussianBlur(first, (0, 0), _SMOOTHING_PX)
    difference = cv2.GaussianBlur((second - offset) / gain, (0, 0), _SMOOTHING_PX) - smooth
    by_x, by_y = (_tiles(cv2.Sobel(smooth, cv2.CV_64F, *order, ksize=1, scale=0.5)) for order in ((1, 0), (0, 1)))
    off = _tiles(difference)
    across, along = _motion(by_x, by_y, off)
    residuals = np.sqrt(np.mean((off - along) ** 2, axis=1))
    sees = np.ptp(_tiles(smooth), axis=1) > 0.1 * contrast
    # Not of all tiles: unlit ones may be free of noise, and then a compression's specks would tell of motion.
    noise = _SMOOTHED * robust_sigma((off - along)[sees].ravel()) if np.any(sees) else np.inf
    strength = np.sum(across[1] ** 2, axis=1)
    tells = np.sqrt(strength) * _SURE_PX > max(noise, 1e-9)
    sees |= residuals > _CHANGED_OF_CONTRAST * contrast
    changed = float(np.mean(residuals[sees] > _CHANGED_OF_CONTRAST * contrast)) if np.count_nonzero(sees) else 0.0
    moved = float(np.median(np.abs(across[0][tells]))) if np.count_nonzero(tells) >= _FEWEST_TILES else None
    return FrameComparison(gain, offset / contrast, moved, changed)


def scale_of(brightest: Image, projector_size: tuple[int, int]) -> float:
    """About how many camera pixels wide a projector pixel is, by the pixels that white (H, W[, 3]) lights."""
    grey = _grey(brightest)
    dark, bright = np.percentile(grey, [2, 99.9])
    lit = np.count_nonzero(grey > dark + _LIT * (bright - dark))
    return float(np.sqrt(lit / (projector_size[0] * projector_size[1])))


def _grey(image: Image) -> Floats:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return cast(Floats, grey.astype(np.float64))


def _brightness(first: Floats, second: Floats) -> tuple[float, float]:
    """Fit robustly the gain and offset that turn one image into the other at most pixels.

    A weak prior keeps black at black, so that an image without contrast determines a gain and no offset.
    """
    step = max(1, first.size // _MOST_PIXELS)
    x, y = np.append(first.reshape(-1)[::step], 0.0), np.append(second.reshape(-1)[::step], 0.0)
    certain = np.append(np.ones(len(x) - 1), _BLACK_OF_ALL * len(x))
    weight: Floats = certain
    gain, offset = 1.0, 0.0
    for _ in range(_ROUNDS):
        mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
        spread = np.average((x - mean_x) ** 2, weights=weight)
        gain = float(np.average((x - mean_x) * (y - mean_y), weights=weight) / max(spread, 1e-9))
        gain = gain if gain > _LEAST_GAIN else 1.0
        offset = float(mean_y - gain * mean_x)
        off = np.abs(y - gain * x - offset)
        scale = max(robust_sigma(off), 1e-6)
        weight = certain * huber_weights(off, scale)
    return gain, offset


def _tiles(image: NDArray[Any]) -> Floats:
    """(tiles, pixels) of an image (H, W)."""
    side = min(_TILE_PX, *image.shape)
    rows, columns = image.shape[0] // side, image.shape[1] // side
    part = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.ascontiguousarray(part.swapaxes(1, 2)).reshape(rows * columns, side * side)


def _motion(by_x: Floats, by_y: Floats, off: Floats) -> tuple[tuple[Floats, Floats], Floats]:
    """Across the stripes of each tile, motion (T,) and slope (T, P); and what it makes of the difference (T, P).

    A picture that moves by u differs by −u times its slope.
    """
    xx, yy, xy = (np.sum(a * b, axis=1) for a, b in ((by_x, by_x), (by_y, by_y), (by_x, by_y)))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    slope = by_x * np.cos(angle)[:, None] + by_y * np.sin(angle)[:, None]
    moved = -np.sum(slope * off, axis=1) / np.maximum(np.sum(slope**2, axis=1), 1e-9)
    return (moved, slope), -moved[:, None] * slope


def take_up(
    begun: Recording,
    rig: Rig,
    patterns: Sequence[Pattern],
    exposures_us: tuple[float, ...] = (),
    response: ProjectorResponse | None = None,
) -> Stream:
    """A capture whose first frames are those that were recorded, and whose others are taken now: what the recording
    says that was to come, or else the rest of `patterns`.

    In between some patterns are shown again. That they look as they did is checked here; they stay in the stream as
    witnesses of smaller motions. Raises InputError if rig or scene are not as they were, or nothing is missing;
    DeviceError.
    """
    repeats = max(1, len(exposures_us))
    planned = begun.planned or tuple(pattern for pattern in patterns for _ in range(repeats))
    _require_first(begun, planned, repeats)
    once, taken = planned[::repeats], len(begun.patterns) // repeats
    again = capture(rig, _witnesses(once[:taken]), exposures_us, response)
    _refuse_other_devices(begun, again.metadata)
    witnesses = [*again.frames]
    _compare(begun, witnesses, repeats)
    rest = capture(rig, once[taken:], exposures_us, response)
    return replace(
        rest,
        patterns=(*begun.patterns[: taken * repeats], *again.patterns, *rest.patterns),
        frames=chain(_recorded(begun, taken * repeats), witnesses, rest.frames),
        metadata={
            **rest.metadata,
            "resumed": {"after_frames": taken * repeats, "begun": begun.metadata.get("captured")},
        },
    )


def _require_first(begun: Recording, planned: Sequence[Pattern], repeats: int) -> None:
    once = [pattern for pattern in planned[::repeats] for _ in range(repeats)]
    if begun.patterns != tuple(planned[: len(begun.patterns)]) or once != list(planned):
        raise InputError(
            f"{begun.folder}: its patterns are not the first of the configured sequence: use the configuration that it "
            "was begun with"
        )
    if len(begun.patterns) == len(planned):
        raise InputError(f"{begun.folder}: nothing is missing; scan replay {begun.folder} makes a result of it")


def _witnesses(taken: Sequence[Pattern]) -> tuple[Pattern, ...]:
    """Return white and, along each axis, the finest stripes of the code and of the fringes, where there are any."""
    chosen: list[Pattern] = []
    chosen += [pattern for pattern in taken if isinstance(pattern, White)][:1]
    for axis in ("x", "y"):
        for kind in (Gray | Xor, Phase):
            chosen += [pattern for pattern in taken if isinstance(pattern, kind) and pattern.axis == axis][-1:]
    return tuple(chosen)


def _refuse_other_devices(begun: Recording, now: Mapping[str, object]) -> None:
    before, devices = begun.metadata.get("devices"), now.get("devices")
    if not isinstance(before, Mapping) or not isinstance(devices, Mapping):
        return
    differing = [
        f"{name}: {before.get(name, 'nothing')} then, {devices.get(name, 'nothing')} now"
        for name in dict.fromkeys([*before, *devices])
        if name not in _MEASURED and str(before.get(name)) != str(devices.get(name))
    ]
    if differing:
        raise InputError(f"{begun.folder}: was begun with another rig, or with other settings: {'; '.join(differing)}")


def _compare(begun: Recording, witnesses: Sequence[tuple[Pattern, Frame]], repeats: int) -> None:
    scale = 0.0  # by the first, which is white if that was shown
    for number, (pattern, frame) in enumerate(witnesses):
        index = begun.patterns.index(pattern) + number % repeats
        before = read_image(begun.folder / begun.files[index])
        scale = scale or scale_of(before, begun.projector_size)
        refuse_another_scene(f"frame {index} ({begun.files[index]})", before, frame.image, scale)


def _recorded(begun: Recording, count: int) -> Iterator[tuple[Pattern, Frame]]:
    for _, frame in zip(range(count), begun.stream().frames, strict=False):
        yield frame
