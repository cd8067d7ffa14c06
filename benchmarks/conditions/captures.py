"""Captures of a simulated room, and changes of their frames before they are written."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast

import cv2
import numpy as np

from calib.numerics import Image
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.capture import CAPTURE_FILE
from scanner.io import flow_yaml
from scanner.patterns import (
    FORMAT,
    PRESETS,
    Axis,
    Black,
    Gray,
    Pattern,
    PresetName,
    White,
    draw,
    frame_line,
    gray_sequence,
    phase_sequence,
    sequence_for,
    size_to_dict,
    xor_sequence,
)

SEQUENCES = (*PRESETS, "gray")
Inverses = Literal["after each bit", "last", "none"]


@dataclass(frozen=True)
class Capture:
    """Patterns and their frames (H, W); the projector's size (width, height) as it will be stated.

    `jpeg`: quality of the saved frames; None for PNG. `tint`: blue, green and red of a colour image, relative to the
    frames' levels; None for grey. `moved_px`: common shift of all frames, right and down.
    """

    patterns: tuple[Pattern, ...]
    frames: tuple[Image, ...]
    projector_size: tuple[int, int]
    jpeg: int | None = None
    tint: tuple[float, float, float] | None = None
    moved_px: tuple[float, float] = (0.0, 0.0)

    def replaced(self, frames: dict[int, Image]) -> "Capture":
        """The capture with some frames replaced."""
        return replace(self, frames=tuple(frames.get(number, frame) for number, frame in enumerate(self.frames)))

    def write(self, folder: Path) -> None:
        """Write a capture folder for `scan replay`."""
        folder.mkdir(parents=True)
        files = self.write_frames(folder / "frames")
        height, width = self.frames[0].shape
        sizes = {"projector": size_to_dict(self.projector_size), "camera": size_to_dict((width, height))}
        lines = [f"{key}: {flow_yaml(value)}\n" for key, value in {"format": FORMAT, **sizes}.items()]
        lines.append("frames:\n")
        lines += [frame_line(f"frames/{file}", p) for file, p in zip(files, self.patterns, strict=True)]
        (folder / CAPTURE_FILE).write_text("".join(lines), encoding="utf-8")

    def write_frames(self, folder: Path) -> list[str]:
        """Write the images alone into a new folder; returns their names."""
        folder.mkdir()
        quality = [cv2.IMWRITE_JPEG_QUALITY, self.jpeg] if self.jpeg is not None else []
        files = [f"{number:03d}.{'png' if self.jpeg is None else 'jpg'}" for number in range(len(self.frames))]
        for file, frame in zip(files, self.frames, strict=True):
            image = frame if self.tint is None else _tinted(frame, self.tint)
            cv2.imwrite(str(folder / file), image, quality)
        return files


def _tinted(frame: Image, tint: tuple[float, float, float]) -> Image:
    return cast(Image, np.rint(frame[..., None] * np.array(tint)).astype(np.uint8))


def patterns_of(sequence: str, projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
    """The patterns of a preset, or of 'gray': Gray code down to a pixel with inverses, and no fringes."""
    if sequence == "gray":
        return sequence_for(projector_size, cell=1, shifts=0)
    return PRESETS[cast(PresetName, sequence)].patterns(projector_size)


def long_fringe(projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
    """A fringe along x that spans the projector, in three steps."""
    return (*phase_sequence("x", float(projector_size[0]), 3),)


def long_fringes(projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
    """White, black, and along each axis a fringe that spans it, in three steps."""
    width, height = projector_size
    return (White(), Black(), *phase_sequence("x", float(width), 3), *phase_sequence("y", float(height), 3))


def xor_code(projector_size: tuple[int, int], *, above_finest: int) -> tuple[Pattern, ...]:
    """White, black, and for each axis an XOR code down to a pixel, whose base is this many bits above the finest."""
    width, height = projector_size
    of_x = xor_sequence("x", width, 1, above_finest=above_finest)
    return (White(), Black(), *of_x, *xor_sequence("y", height, 1, above_finest=above_finest))


def bits_alone(projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
    """White, black, and a Gray code down to a pixel along both axes, without inverses."""
    width, height = projector_size
    of_x = gray_sequence("x", width, 1, inverses=False)
    return (White(), Black(), *of_x, *gray_sequence("y", height, 1, inverses=False))


def bits_in_order(
    projector_size: tuple[int, int], *, axis: Axis, finest_first: bool, inverses: Inverses
) -> tuple[Pattern, ...]:
    """Gray code along one axis down to a pixel. White and black come first; bits with inverses need none."""
    bits = [*gray_sequence(axis, projector_size[0 if axis == "x" else 1], 1, inverses=False)]
    bits = bits[::-1] if finest_first else bits
    inverted = [replace(bit, inverted=True) for bit in bits]
    if inverses == "after each bit":
        return tuple(shown for pair in zip(bits, inverted, strict=True) for shown in pair)
    return (White(), Black(), *bits, *(inverted if inverses == "last" else ()))


def xor_along_x(projector_size: tuple[int, int], *, above_finest: int) -> tuple[Pattern, ...]:
    """White, black, and an XOR code along x."""
    return (White(), Black(), *xor_sequence("x", projector_size[0], 1, above_finest=above_finest))


def take(room: SimulatedRoom, patterns: tuple[Pattern, ...], exposure: float) -> Capture:
    """Take all frames, at a multiple of the suitable exposure of the room."""
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    camera.expose_for(exposure * room.sensor.exposure_us)
    frames = []
    for pattern in patterns:
        projector.show(draw(pattern, projector.size))
        frames.append(camera.grab().image)
    return Capture(patterns, tuple(frames), projector.size)


def blended(first: Image, second: Image, share: float) -> Image:
    """The first image with a share of the second one's light."""
    return cast(Image, np.rint((1 - share) * first.astype(float) + share * second).astype(first.dtype))


def brightened(image: Image, factor: float) -> Image:
    """An image with its exposure scaled by a factor."""
    return cast(Image, np.rint(np.clip(factor * image.astype(float), 0, 255)).astype(image.dtype))


def inverses(patterns: Sequence[Pattern]) -> list[tuple[int, int]]:
    """Numbers of the frames of each pattern and its inverse."""
    number = {pattern: index for index, pattern in enumerate(patterns)}
    pairs = [(p, replace(p, inverted=True)) for p in patterns if isinstance(p, Gray) and not p.inverted]
    return [(number[shown], number[inverse]) for shown, inverse in pairs if inverse in number]
