"""Frames of a synthetic scene: a wall and a box in front of it, seen obliquely, lit by an imperfect projector.

Only the drawing of patterns is shared with the decoder. An 8-bit pattern passes through the projector's gamma and lens
blur. It is sampled at 3 × 3 points of each camera pixel on the visible surface, shaded, and blurred by the camera's
lens. Interreflection and ambient light are added. Read-out adds shot noise, read noise and quantisation.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from calib.numerics import Bools, Image
from scanner.decoding import Decoder, Decoding, FrameCollector, FrameCorrections, estimate_corrections
from scanner.patterns import Pattern, Phase, draw, phase_sequence

Light = NDArray[np.floating[Any]]
_FINE = 3


@dataclass(frozen=True)
class Scene:
    """Sizes are (width, height). `exposure`: grey level (of 255) of a fully lit white wall of albedo 1."""

    camera: tuple[int, int] = (300, 225)
    projector: tuple[int, int] = (300, 200)
    gamma: float = 2.2
    exposure: float = 200.0
    ambient: float = 8.0
    black_level: float = 0.01
    indirect: float = 0.15
    projector_blur_px: float = 0.5
    camera_blur_px: float = 0.6
    read_noise: float = 1.0
    electrons_per_level: float = 30.0
    depth_bits: int = 8
    colour: bool = False
    turn_deg: float = 4.0
    zoom: float = 0.8
    box_brightness: float = 1.0
    seed: int = 1

    def wall(self, u: Light, v: Light) -> tuple[Light, Light]:
        """Projector coordinates of the wall at camera pixels (u, v)."""
        return self._plane(u, v, shift=0.0, tilt=0.12)

    def box(self, u: Light, v: Light) -> tuple[Light, Light]:
        """Projector coordinates of the front of the box at camera pixels (u, v)."""
        return self._plane(u, v, shift=-0.11, tilt=-0.25)

    def _plane(self, u: Light, v: Light, shift: float, tilt: float) -> tuple[Light, Light]:
        (width, height), (p_width, p_height) = self.camera, self.projector
        a, b = (u - width / 2) / width, (v - height / 2) / width
        turn = np.radians(self.turn_deg)
        a, b = np.cos(turn) * a - np.sin(turn) * b, np.sin(turn) * a + np.cos(turn) * b
        w = (1 + tilt * a + 0.05 * b) / self.zoom
        return (a / w + shift + 0.5) * p_width - 0.5, b / w * p_width + (p_height - 1) / 2

    def is_box(self, u: Light, v: Light) -> Bools:
        """Whether camera pixels (u, v) see the box."""
        width, height = self.camera
        return (np.abs(u - 0.42 * width - 0.03 * v) < 0.13 * width) & (np.abs(v - 0.55 * height) < 0.22 * height)

    def is_shadow(self, u: Light, v: Light) -> Bools:
        """Whether camera pixels (u, v) see the box's shadow on the wall."""
        width, height = self.camera
        beside = np.abs(u - 0.62 * width - 0.03 * v) < 0.08 * width
        return beside & (np.abs(v - 0.55 * height) < 0.22 * height) & ~self.is_box(u, v)

    def seen(self) -> tuple[Light, Light, Light, Bools]:
        """For the sub-pixels: projector x and y, brightness in full light, and whether they are on the box."""
        width, height = self.camera
        u, v = np.meshgrid(*((np.arange(size * _FINE) + 0.5) / _FINE - 0.5 for size in (width, height)), sparse=True)
        on_box = self.is_box(u, v)
        x, y = (np.where(on_box, a, b).astype(np.float32) for a, b in zip(self.box(u, v), self.wall(u, v), strict=True))
        inside = (x > -0.5) & (x < self.projector[0] - 0.5) & (y > -0.5) & (y < self.projector[1] - 0.5)
        texture = 0.75 + 0.1 * np.sin(u / 9) * np.cos(v / 13) + 0.1 * ((u // 47 + v // 31) % 2)
        albedo = np.where(on_box, self.box_brightness * (0.8 - 0.2 * ((v // 23) % 2)), texture)
        return x, y, (albedo * inside * ~self.is_shadow(u, v)).astype(np.float32), on_box

    def frame(self, pattern: Pattern, number: int) -> Image:
        """The frame that the camera records."""
        return _frame(self, pattern, number).copy()

    def frames(self, patterns: Sequence[Pattern]) -> list[Image]:
        """All frames of a sequence."""
        return [self.frame(pattern, number) for number, pattern in enumerate(patterns)]

    def decode(self, patterns: Sequence[Pattern]) -> Decoding:
        """Frames of a sequence, decoded."""
        return decode(patterns, self.frames(patterns), self.projector)

    def errors(self, decoding: Decoding) -> NDArray[np.float64]:
        """Errors (N, 2) of matches; at the edge of the box, those relative to the nearer surface."""
        u, v = decoding.matches.camera_px.T
        on_wall, on_box = (
            decoding.matches.projector_px - np.stack(surface(u, v), axis=1) for surface in (self.wall, self.box)
        )
        around = [self.is_box(u + du, v + dv) for du in (-1, 0, 1) for dv in (-1, 0, 1)]
        box_is_nearer = np.linalg.norm(on_box, axis=1) < np.linalg.norm(on_wall, axis=1)
        takes_box = np.all(around, axis=0) | (np.any(around, axis=0) & box_is_nearer)
        return np.where(takes_box[:, None], on_box, on_wall)

    def well_lit(self, margin_px: int = 3) -> Bools:
        """Directly lit pixels away from all edges, (H, W)."""
        _, _, reflected, on_box = _fine(_seen_alike(self))
        lit, boxed = (
            cv2.resize(part.astype(np.uint8), self.camera, interpolation=cv2.INTER_NEAREST)
            for part in (reflected > 0, on_box)
        )
        kernel = np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8)
        edge = cv2.morphologyEx(boxed, cv2.MORPH_GRADIENT, kernel)
        return (cv2.erode(lit, kernel, borderValue=0) > 0) & (edge == 0)


@dataclass(frozen=True)
class Turned(Scene):
    """The scene after the camera has turned, which shifts the whole picture."""

    right_px: float = 0.0
    down_px: float = 0.0

    def frame(self, pattern: Pattern, number: int) -> Image:
        still = super().frame(pattern, number)
        # OpenCV's cubic interpolation shifts ramps by up to 0.05 px.
        moved = ndimage.shift(still.astype(np.float64), (self.down_px, self.right_px), order=3, mode="nearest")
        return np.rint(np.clip(moved, 0, 255)).astype(np.uint8)


@lru_cache(maxsize=512)
def _frame(scene: Scene, pattern: Pattern, number: int) -> Image:
    rng = np.random.default_rng((scene.seed, number))
    levels = scene.exposure * _light(_lit_alike(scene), pattern) + scene.ambient
    variance = levels / scene.electrons_per_level + scene.read_noise**2
    levels = levels + np.sqrt(variance) * rng.standard_normal(levels.shape, np.float32)
    top = 2**scene.depth_bits - 1
    grey = np.clip(np.rint(levels * (top / 255)), 0, top).astype(np.uint8 if scene.depth_bits == 8 else np.uint16)
    return np.stack([grey // 2, grey, grey], axis=-1) if scene.colour else grey


def _lit_alike(scene: Scene) -> Scene:
    """The scene without settings of the camera's read-out, so that its light is computed once."""
    return replace(scene, exposure=1.0, ambient=0.0, read_noise=0.0, depth_bits=8, colour=False, seed=0)


def _seen_alike(scene: Scene) -> Scene:
    """The scene without settings of its light and lenses, so that what is in view is found once."""
    plain = replace(_lit_alike(scene), gamma=1.0, black_level=0.0, indirect=0.0)
    return replace(plain, projector_blur_px=0.0, camera_blur_px=0.0)


@lru_cache(maxsize=512)
def _light(scene: Scene, pattern: Pattern) -> Light:
    """Light at the camera, 1 for full light on white, (H, W)."""
    shown: Any = (draw(pattern, scene.projector) / np.float32(255)) ** np.float32(scene.gamma)
    shown = scene.black_level + (1 - scene.black_level) * shown
    if scene.projector_blur_px:
        shown = cv2.GaussianBlur(shown, (0, 0), scene.projector_blur_px, borderType=cv2.BORDER_REPLICATE)
    x, y, reflected, _ = _fine(_seen_alike(scene))
    fine = reflected * cv2.remap(shown, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    direct = cv2.resize(fine, scene.camera, interpolation=cv2.INTER_AREA)
    if scene.camera_blur_px:
        direct = cv2.GaussianBlur(direct, (0, 0), scene.camera_blur_px)
    coarse = cv2.resize(direct, None, fx=0.1, fy=0.1, interpolation=cv2.INTER_AREA)
    around = cv2.GaussianBlur(coarse, (0, 0), coarse.shape[1] / 5, borderType=cv2.BORDER_CONSTANT)
    bounced = cv2.resize(around, scene.camera, interpolation=cv2.INTER_CUBIC)
    return direct + np.float32(scene.indirect) * bounced


@lru_cache(maxsize=8)
def _fine(scene: Scene) -> tuple[Light, Light, Light, Bools]:
    return scene.seen()


def corrections_to(
    patterns: Sequence[Pattern], frames: Sequence[Image], projector: tuple[int, int]
) -> FrameCorrections:
    """What is found to affect all frames."""
    collector = FrameCollector(patterns, projector, calibrated=False)
    for frame in frames:
        collector.add(frame.astype(np.uint8))
    return estimate_corrections(collector.complete())


def decode(patterns: Sequence[Pattern], frames: Iterable[Image], projector: tuple[int, int]) -> Decoding:
    """All frames through a decoder."""
    decoder = Decoder(patterns, projector)
    for frame in frames:
        decoder.add(frame)
    return decoder.finish()


def dimmed(scene: Scene, factor: float) -> Scene:
    """The same scene with a fraction of the light."""
    return replace(scene, exposure=scene.exposure * factor, ambient=scene.ambient * factor)


def fringes(periods: Sequence[float], shifts: int) -> tuple[Phase, ...]:
    """Fringes along both axes."""
    return tuple(p for axis in ("x", "y") for period in periods for p in phase_sequence(axis, period, shifts))
