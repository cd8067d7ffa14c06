"""A simulated room photographed under any patterns, saved with the names and order of other programs.

Folders of frames as other programs leave them, and their import.
"""

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
from scanner.commands import main
from scanner.patterns import PRESETS, Axis, Black, Gray, Pattern, Phase, White, draw
from tests.support.small_capture import with_few_rays

# A projector that is often met, and of which none shows the same in longer cells, so that its size is recognised.
CAMERA, PROJECTOR = (459, 384), (640, 480)
AXES: tuple[tuple[Axis, int], ...] = (("x", 640), ("y", 480))
KNOWN = ("--projector", "640x480")


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


PAIRS = [*bits("x", 10), *bits("y", 9)]
CENTRED = [*bits("x", 9, 2, 192), *bits("y", 9, 1, 16)]  # (1024 − 640) / 2 and (512 − 480) / 2 pixels before the first
QUARTERS, MINUS_COSINE = (0.0, 0.25, 0.5, 0.75), (0.5, 0.3, 0.1, -0.1, -0.3)
THIRDS, BACKWARDS = (-1 / 3, 0.0, 1 / 3), (0.0, -1 / 3, -2 / 3)
FRINGES = [shown for axis, _ in AXES for period in (80 / 3, 40.0) for shown in steps(axis, period, THIRDS)]
LONG_AND_SHORT = {
    axis: [*steps(axis, length / 16, BACKWARDS), *steps(axis, float(length), BACKWARDS)] for axis, length in AXES
}
NINE_STEPS = [
    shown
    for axis, length in AXES
    for shown in (*steps(axis, length / 8, [-step / 9 for step in range(9)]), *steps(axis, float(length), BACKWARDS))
]
COARSE = {"x": bits("x", 10, inverses=False), "y": bits("y", 6, 8, inverses=False)}
HETERODYNE = [p for axis, length in AXES for count in (59, 64, 70) for p in steps(axis, length / count, QUARTERS)]
SINE_BACKWARDS = [p for count in (70, 64, 59) for p in steps("x", 640 / count, [0.75 - step / 3 for step in range(3)])]
FOUR_PERIODS = [
    *(p for axis, length in AXES[::-1] for count in (25, 28, 31, 32) for p in steps(axis, length / count, BACKWARDS)),
    *ENDS,
]
COMPLEMENTARY = [  # a fringe of 20 periods, a code of 40 cells
    *ENDS,
    *(
        p
        for axis, length in AXES
        for p in (*steps(axis, length / 20, MINUS_COSINE), *bits(axis, 6, length // 40, inverses=False))
    ),
]
SHIFTED = [  # a code of 20 cells, and again half a cell further
    p
    for axis, length in AXES
    for p in (
        *steps(axis, length / 20, QUARTERS),
        *bits(axis, 5, length // 20, inverses=False),
        *bits(axis, 5, length // 20, length // 40, inverses=False),
    )
]
UNEVEN = [  # 32 periods: half of one is 10 px along x, 7.5 px along y
    p
    for axis, length in AXES
    for p in (*steps(axis, length / 32, QUARTERS), *bits(axis, 6, length / 64, inverses=False))
]
SQUARE = [  # periods of 40 px along both axes: 16 and 12
    p for axis, _ in AXES[::-1] for p in (*steps(axis, 40.0, QUARTERS), *bits(axis, 5, 20, inverses=False))
]
TURNS = [bit for pair in zip(bits("y", 9, inverses=False), bits("x", 10, inverses=False), strict=False) for bit in pair]
FROM_THE_MIDDLE = [*bits("x", 10, 1, 192), *bits("y", 9, 1, 16)]


def in_colour(image: Image) -> Image:
    return np.stack([image // 2, image, image], axis=-1).astype(np.uint8)


def deep(image: Image) -> Image:
    return image.astype(np.uint16) * 250 + 77


def named(form: str, start: int = 0) -> Iterator[str]:
    """Numbered names, from `start` on."""
    return (form.format(number) for number in count(start))


def sltk() -> Iterator[str]:
    for number in range(40):
        axis, place, inverted = number // 20, 9 - number % 20 // 2, number % 2
        yield f"{1481302049.5 + 2 * number}_[{axis:02d}-{place:02d}-{inverted:02d}_{number:02d}]_img.jpg"


def evenly_exposed(image: Image) -> Image:
    """A frame of a camera that exposes each for the same mean."""
    return np.clip(np.rint(image * np.clip(40 / image.mean(), 0.4, 3.5)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Foreign:
    """`patterns` in the order of `names`; the required `arguments`; the format of the camera's files."""

    layout: str
    patterns: list[Pattern]
    names: Iterator[str]
    arguments: tuple[str, ...] = ()
    change: Callable[[Image], Image] = np.asarray


FOREIGN = {
    "this program's standard": Foreign("scan", [*PRESETS["standard"].patterns(PROJECTOR)], named("{:03d}.png")),
    "this program's quick": Foreign("scan", [*PRESETS["quick"].patterns(PROJECTOR)], named("{:03d}.png")),
    "opencv": Foreign("opencv", [*PAIRS, *ENDS], named("pattern_cam1_im{}.png", 1)),
    "opencv, black and white first": Foreign("opencv", [Black(), White(), *PAIRS], named("{}.tif"), change=deep),
    "opencv, without": Foreign("opencv", PAIRS, named("IMG_{:05d}.JPG", 997), change=in_colour),
    "opencv, white and black apart": Foreign(
        "opencv", [*PAIRS, *ENDS], iter([*(f"p{n}.png" for n in range(38)), "white.png", "black.png"])
    ),
    "opencv, of two pixels": Foreign(
        "opencv", [*bits("x", 9, 2), *bits("y", 8, 2), *ENDS], named("{}.png"), ("--cell", "2")
    ),
    "opencv, exposed automatically": Foreign("opencv", [*PAIRS, *ENDS], named("f{}.png"), change=evenly_exposed),
    "gray, y and x by turns": Foreign("gray", [*TURNS, Gray("x", 9, 10), *ENDS], named("{:03d}.jpg")),
    "gray, from the middle": Foreign("3dunderworld", [*ENDS, *FROM_THE_MIDDLE], named("{}.png")),
    "procam-calibration": Foreign("procam-calibration", [*PAIRS, *ENDS], named("graycode_{:02d}.png")),
    "phase-shifting": Foreign(
        "phase-shifting",
        [*FRINGES, *bits("x", 4, 40), *bits("y", 4, 40), *ENDS],
        named("pat{:02d}.png"),
        (*KNOWN, "--cell", "40"),
    ),
    "moreno-taubin": Foreign("moreno-taubin", [*ENDS, *CENTRED], named("cam_{:02d}.png", 1)),
    "3dunderworld": Foreign("3dunderworld", [*ENDS, *PAIRS], named("{:04d}.jpg")),
    "sltk": Foreign("sltk", [*bits("x", 10), *bits("y", 10)], sltk()),
    "sltk, renamed": Foreign("sltk", [*bits("x", 10), *bits("y", 10)], named("{}.png")),
    "slstudio-gray": Foreign("slstudio-gray", [*ENDS, *COARSE["x"], *COARSE["y"]], named("frame {}.bmp")),
    "slstudio-gray, x": Foreign("slstudio-gray", [*ENDS, *COARSE["x"]], named("{}.bmp"), KNOWN),
    "slstudio-2x3": Foreign("slstudio-2x3", [*LONG_AND_SHORT["x"], *LONG_AND_SHORT["y"]], named("{}.png"), KNOWN),
    "slstudio-2x3, y": Foreign("slstudio-2x3", LONG_AND_SHORT["y"], named("{}.png"), KNOWN),
    "slstudio-nstep": Foreign("slstudio-nstep", NINE_STEPS, named("{}.png"), KNOWN),
    "heterodyne": Foreign("heterodyne", HETERODYNE, named("{}.png"), (*KNOWN, "--periods", "59,64,70")),
    "heterodyne, x, of usual periods": Foreign("heterodyne", SINE_BACKWARDS, named("{}.png"), KNOWN),
    "heterodyne, four periods, y first": Foreign(
        "heterodyne", FOUR_PERIODS, named("{}.bmp"), (*KNOWN, "--periods", "25,28,31,32")
    ),
    "gray-fringes, complementary": Foreign("gray-fringes", COMPLEMENTARY, named("{}.png"), (*KNOWN, "--periods", "20")),
    "gray-fringes, uneven": Foreign("gray-fringes", UNEVEN, named("{}.bmp"), (*KNOWN, "--periods", "32")),
    "gray-fringes, square": Foreign(
        "gray-fringes", SQUARE, named("{}.bmp"), (*KNOWN, "--periods", "16", "--order", "2")
    ),
    "gray-fringes, shifted": Foreign("gray-fringes", SHIFTED, named("{}.png"), (*KNOWN, "--periods", "20")),
}


def imported(source: Path, *arguments: object) -> int:
    return main(["import", str(source), *map(str, arguments)])


def same(one: Pattern, other: Pattern) -> bool:
    """Compare sequences up to rounding of periods and shifts."""
    if isinstance(one, Phase) and isinstance(other, Phase):
        return one.axis == other.axis and np.allclose((one.period, one.shift), (other.period, other.shift), atol=1e-9)
    return one == other
