"""Changes of a capture's frames by devices, software or mistakes."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from calib.numerics import Floats, Image
from conditions.captures import Capture, blended, brightened, inverses
from scanner.patterns import Gray

# Variance of a pixel's shot noise per grey level, as of the simulated camera.
_PER_LEVEL = 255 / 10_500

Random = np.random.Generator
OfFrames = Callable[[Capture, Random], Capture]


def compressed(quality: int, tint: tuple[float, float, float] | None = None) -> OfFrames:
    """Save as JPEG; in colour, with these shares of blue, green and red, and half the chroma resolution."""

    def frames(capture: Capture, _: Random) -> Capture:
        return replace(capture, jpeg=quality, tint=tint)

    return frames


def developed(contrast: float, quality: int) -> OfFrames:
    """Frames of 16 bits as photographs: the sRGB transfer function (IEC 61966-2-1), with an S-curve by a share
    `contrast`.

    Beyond 1, another S-curve is added. Frames are saved as JPEG.
    """
    light = np.linspace(0, 1, 2**16)
    level = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-6) ** (1 / 2.4) - 0.055)
    for share in (min(contrast, 1.0), max(contrast - 1, 0.0)):
        level += share * (level**2 * (3 - 2 * level) - level)
    digits = np.rint(255 * level).astype(np.uint8)

    def frames(capture: Capture, _: Random) -> Capture:
        return replace(capture, frames=tuple(digits[frame] for frame in capture.frames), jpeg=quality)

    return frames


def any_frame(capture: Capture, rng: Random) -> int:
    """A random frame other than white and black, which are first."""
    return int(rng.integers(3, len(capture.frames)))


def one_frame(factor: float) -> OfFrames:
    def changed(capture: Capture, rng: Random) -> Capture:
        frame = any_frame(capture, rng)
        return capture.replaced({frame: brightened(capture.frames[frame], factor)})

    return changed


def late(share: float) -> OfFrames:
    def changed(capture: Capture, rng: Random) -> Capture:
        frame = any_frame(capture, rng)
        return capture.replaced({frame: blended(capture.frames[frame], capture.frames[frame - 1], share)})

    return changed


def stated(factor: float) -> OfFrames:
    def changed(capture: Capture, _: Random) -> Capture:
        width, height = capture.projector_size
        return replace(capture, projector_size=(round(factor * width), round(factor * height)))

    return changed


def swapped(capture: Capture, _: Random) -> Capture:
    return replace(capture, projector_size=capture.projector_size[::-1])


def exchanged(capture: Capture, rng: Random) -> Capture:
    first, second = (int(frame) for frame in rng.choice(len(capture.frames), 2, replace=False))
    return capture.replaced({first: capture.frames[second], second: capture.frames[first]})


def repeated(capture: Capture, rng: Random) -> Capture:
    frame = any_frame(capture, rng)
    return capture.replaced({frame: capture.frames[int(rng.choice(frame))]})


def inverted(capture: Capture, rng: Random) -> Capture:
    pairs = inverses(capture.patterns)
    if not pairs:
        frame = any_frame(capture, rng)  # a code without inverses: inverted by the camera software
        return capture.replaced({frame: 255 - capture.frames[frame]})
    shown, inverse = pairs[int(rng.integers(len(pairs)))]
    return capture.replaced({shown: capture.frames[inverse], inverse: capture.frames[shown]})


def each_exposed(factor: float) -> OfFrames:
    """Each frame is randomly up to this many times darker, including white and black."""

    def changed(capture: Capture, rng: Random) -> Capture:
        factors = factor ** -rng.uniform(0, 1, len(capture.frames))
        frames = [brightened(frame, float(by)) for frame, by in zip(capture.frames, factors, strict=True)]
        return replace(capture, frames=tuple(frames))

    return changed


def late_rows(share: float, which: str) -> OfFrames:
    """Rows that are read out while the picture changes: the 'lower' quarter, or 'every second' one (interlaced)."""

    def changed(capture: Capture, _: Random) -> Capture:
        height = len(capture.frames[0])
        rows = np.s_[3 * height // 4 :] if which == "lower" else np.s_[::2]
        frames = [capture.frames[0]]
        for before, frame in pairwise(capture.frames):
            mixed = frame.copy()
            mixed[rows] = blended(frame[rows], before[rows], share)
            frames.append(mixed)
        return replace(capture, frames=tuple(frames))

    return changed


def finest_bit_twice(capture: Capture, _: Random) -> Capture:
    """The frames of each axis's finest bit repeat those of the previous bit."""
    at = {pattern: number for number, pattern in enumerate(capture.patterns)}
    finest = [(n, p) for p, n in at.items() if isinstance(p, Gray) and p.bit == p.bits - 1]
    return capture.replaced({n: capture.frames[at[replace(p, bit=p.bit - 1)]] for n, p in finest})


def phone(capture: Capture, _: Random) -> Capture:
    """Noise is smoothed away except at edges, and edges are sharpened."""
    return _each(capture, _smoothed_and_sharpened)


def _smoothed_and_sharpened(frame: Image) -> Floats:
    smooth = cv2.bilateralFilter(frame.astype(np.float32), 5, 12.0, 1.5)
    return np.asarray(2.0 * smooth - cv2.GaussianBlur(smooth, (0, 0), 1.5), np.float64)


def tone_mapped(capture: Capture, _: Random) -> Capture:
    """Each frame is brightened where its surroundings are dark, as by a phone's HDR, and by a curve."""
    return _each(capture, _mapped)


def _mapped(frame: Image) -> Floats:
    level = frame.astype(np.float64) / 255
    around = cv2.GaussianBlur(level, (0, 0), frame.shape[1] / 12)
    gain = ((around + 0.1) / (level.mean() + 0.1)) ** -0.3
    return np.asarray(255 * np.clip(gain * level, 0, 1) ** (1 / 1.6), np.float64)


def shaken(length_px: float) -> OfFrames:
    """Camera shake during each exposure, always in the same direction; noise is added afterwards."""

    def changed(capture: Capture, rng: Random) -> Capture:
        angle = rng.uniform(0, np.pi)
        along = np.linspace(-length_px / 2, length_px / 2, 9)
        steps = [(float(by * np.cos(angle)), float(by * np.sin(angle))) for by in along]

        def blurred(frame: Image) -> Floats:
            light = np.mean([_moved(frame, step) for step in steps], axis=0)
            return np.asarray(light + rng.normal(size=light.shape) * np.sqrt(_PER_LEVEL * light), np.float64)

        return _each(capture, blurred)

    return changed


def resampled(by_px: tuple[float, float] | float) -> OfFrames:
    """All frames are shifted equally, or each randomly up to this distance, as by video stabilisation."""

    def changed(capture: Capture, rng: Random) -> Capture:
        if not isinstance(by_px, tuple):
            moves = rng.uniform(-by_px, by_px, (len(capture.frames), 2)).tolist()
        else:
            moves = [by_px] * len(capture.frames)
        frames = [_whole(_moved(frame, move)) for frame, move in zip(capture.frames, moves, strict=True)]
        return replace(capture, frames=tuple(frames), moved_px=by_px if isinstance(by_px, tuple) else (0.0, 0.0))

    return changed


def _moved(frame: Image, by_px: tuple[float, float]) -> Floats:
    by = np.array([[1, 0, by_px[0]], [0, 1, by_px[1]]], np.float64)
    size = frame.shape[1], frame.shape[0]
    moved = cv2.warpAffine(frame.astype(np.float64), by, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float64)


def _each(capture: Capture, change: Callable[[Image], Floats]) -> Capture:
    return replace(capture, frames=tuple(_whole(change(frame)) for frame in capture.frames))


def _whole(frame: Floats) -> Image:
    return np.rint(np.clip(frame, 0, 255)).astype(np.uint8)
