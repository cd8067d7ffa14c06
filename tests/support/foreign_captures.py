"""A simulated room photographed under any patterns, saved with the names and order of other programs."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.numerics import Image
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, draw
from tests.support.small_capture import with_few_rays


@dataclass
class Photographer:
    """Takes each pattern once."""

    room: SimulatedRoom
    projector_size: tuple[int, int]
    taken: dict[Pattern, Image] = field(default_factory=dict)

    def take(self, pattern: Pattern) -> Image:
        if pattern not in self.taken:
            projector = SimulatedProjector(self.room)
            camera = SimulatedCamera(self.room, projector)
            projector.show(draw(pattern, self.projector_size))
            self.taken[pattern] = camera.grab().image
        return self.taken[pattern]

    def write(
        self,
        folder: Path,
        patterns: Sequence[Pattern],
        names: Iterable[str],
        change: Callable[[Image], Image] = lambda image: image,
    ) -> Path:
        """Write a folder with a file for each pattern, in the order of the names."""
        folder.mkdir(parents=True, exist_ok=True)
        for pattern, name in zip(patterns, names, strict=False):
            quick = [cv2.IMWRITE_PNG_COMPRESSION, 0] if name.endswith(".png") else []
            assert cv2.imwrite(str(folder / name), change(self.take(pattern)), quick)
        return folder


def photographer(camera: tuple[int, int], projector: tuple[int, int], seed: int = 0) -> Photographer:
    settings = SimulatedRigSettings(seed=seed, albedo=0.5, furniture=False)
    with pytest.MonkeyPatch.context() as patch:
        with_few_rays(patch)
        return Photographer(SimulatedRoom(settings, camera, projector), projector)


ENDS: list[Pattern] = [White(), Black()]


def bits(axis: Axis, number: int, cell: float = 1, offset: int = 0, *, inverses: bool = True) -> list[Pattern]:
    """The bits of a Gray code, most significant first, each followed by its inverse, as in all the sources."""
    signs = (False, True) if inverses else (False,)
    return [Gray(axis, bit, number, cell, offset, inverted) for bit in range(number) for inverted in signs]


def steps(axis: Axis, period: float, shifts: Iterable[float]) -> list[Pattern]:
    return [Phase(axis, period, shift) for shift in shifts]


def in_colour(image: Image) -> Image:
    return np.stack([image // 2, image, image], axis=-1).astype(np.uint8)


def deep(image: Image) -> Image:
    return image.astype(np.uint16) * 250 + 77


def named(form: str, start: int = 0) -> Iterator[str]:
    """Numbered names, from `start` on."""
    return (form.format(number) for number in count(start))
