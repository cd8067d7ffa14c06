"""The layouts that are known, each a row. Facts are from the sources named; docs/import.md has them in words."""

import re
from pathlib import Path

from scanner.importing.layout import FrameLayout, Given, SequenceOf, Size
from scanner.importing.orders import fringe, gray_bits, other_gray_orders, pairs, with_ends, x_and_y
from scanner.io import read_text
from scanner.patterns import PRESETS, Axis, Black, Gray, Pattern, White, count_bits


def _moreno_taubin(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
    """White, black, as many of the coarsest bits of x as of y, counted from the middle."""
    most = min(*(count_bits(length, cell) for length in size), (frames - 2) // 4)
    if most < 1:
        return ()
    codes = (bit for axis, length in x_and_y(size) for bit in gray_bits(axis, length, cell, most=most, centred=True))
    return (White(), Black(), *codes)


_COUNT = re.compile("[0-9]{1,5}")


def _projector_info(folder: Path) -> Given:
    """`projector_info.txt`: how many codes there are in x and in y."""
    path = folder / "projector_info.txt"
    words = read_text(path).split() if path.is_file() else []
    if len(words) < 2 or not all(_COUNT.fullmatch(word) for word in words[:2]):
        return Given()
    return Given(codes=(int(words[0]), int(words[1])))


def _phase_shifting(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
    """Fringes of two thirds of a Gray cell and of a whole one; of x, then of y; Gray code; white, black."""
    fringes = (
        pattern
        for axis, _ in x_and_y(size)
        for period in (2 * cell / 3, float(cell))
        for pattern in fringe(axis, period, 3, first=-1 / 3)
    )
    return (*fringes, *pairs(size, cell, frames), White(), Black())


def _phase_shifting_settings(folder: Path) -> Given:
    """`config.xml`: the display's size, and `step`, which is two Gray cells."""
    for path in (folder / "config.xml", folder.parent / "config.xml"):
        if path.is_file():
            return _read_config(path)
    return Given()


def _read_config(path: Path) -> Given:
    text = read_text(path)
    entries = [
        re.search(rf"<{key}>\s*([0-9]{{1,5}})\.?\s*</{key}>", text) for key in ("disp_width", "disp_height", "step")
    ]
    width, height, step = (int(number[1]) if number else 0 for number in entries)
    if min(width, height) < 1 or step < 2:
        return Given()  # a config.xml of another program
    return Given((width, height), step // 2)


def _slstudio_gray(*axes: Axis) -> SequenceOf:
    """White, black, the ten coarsest bits of x, the six coarsest of y; no inverses."""

    def sequence(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
        del frames
        lengths, most = dict(x_and_y(size)), {"x": 10, "y": 6}
        codes = [bit for axis in axes for bit in gray_bits(axis, lengths[axis], cell, inverses=False, most=most[axis])]
        return (White(), Black(), *codes)

    return sequence


def _slstudio_fringes(cycles: int, steps: int, *axes: Axis) -> SequenceOf:
    """This many cycles in this many steps, then a single cycle in three, for each axis; in reverse direction."""

    def sequence(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
        del cell, frames
        lengths = dict(x_and_y(size))
        return tuple(
            pattern
            for axis in axes
            for number, count in ((cycles, steps), (1, 3))
            for pattern in fringe(axis, lengths[axis] / number, count, sign=-1)
        )

    return sequence


def _sltk(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
    """As many bits for the shorter axis as for the longer one, in pairs."""
    del frames
    bits = max(count_bits(length, cell) for length in size)
    return tuple(bit for axis, length in x_and_y(size) for bit in gray_bits(axis, length, cell, least=bits))


_SLTK_NAME = re.compile(r"\[(\d+)-(\d+)-(\d+)_\d+\]")


def _sltk_names(files: tuple[Path, ...]) -> tuple[Pattern, ...]:
    """`TIME_[AXIS-PLACE-INVERTED_NUMBER]_img`: axis 0 is x, place 0 the finest bit; empty if a name is another."""
    name_matches = [_SLTK_NAME.search(path.stem) for path in files]
    numbers = [tuple(map(int, match.groups())) for match in name_matches if match]
    if len(numbers) < len(files) or any(axis > 1 or inverted > 1 for axis, _, inverted in numbers):
        return ()
    bits = [1 + max((place for axis, place, _ in numbers if axis == number), default=0) for number in (0, 1)]
    axes: tuple[Axis, ...] = ("x", "y")
    return tuple(
        Gray(axes[axis], bits[axis] - 1 - place, bits[axis], inverted=inverted == 1)
        for axis, place, inverted in numbers
    )


def _standard(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
    """This program's own sequence of that name."""
    del cell, frames
    return PRESETS["standard"].patterns(size)


def _quick(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
    """This program's own sequence of that name."""
    del cell, frames
    return PRESETS["quick"].patterns(size)


_BOTH: tuple[tuple[Axis, ...], ...] = (("x", "y"), ("x",), ("y",))

LAYOUTS = (
    FrameLayout(
        "scan",
        "This program's standard and quick sequences",
        "docs/formats.md",
        (_standard, _quick),
    ),
    FrameLayout(
        "opencv",
        "OpenCV GrayCodePattern",
        "https://github.com/opencv/opencv_contrib, modules/structured_light: graycodepattern.cpp, cap_pattern.cpp",
        with_ends(pairs, first=True, last=True, without=True),
    ),
    FrameLayout(
        "procam-calibration",
        "kamino410/procam-calibration",
        "https://github.com/kamino410/procam-calibration, gen_graycode_imgs.py",
        with_ends(pairs, last=True),
    ),
    FrameLayout(
        "phase-shifting",
        "kamino410/phase-shifting",
        "https://github.com/kamino410/phase-shifting, phase_shifting.py",
        (_phase_shifting,),
        needs=("projector_size", "cell"),
        settings=_phase_shifting_settings,
    ),
    FrameLayout(
        "moreno-taubin",
        "Moreno and Taubin, scan3d-capture",
        "http://mesh.brown.edu/calibration, scan3d-capture: ProjectorWidget.cpp, CaptureDialog.cpp",
        (_moreno_taubin,),
        settings=_projector_info,
    ),
    FrameLayout(
        "3dunderworld",
        "3DUNDERWORLD SLS",
        "https://github.com/theICTlab/3DUNDERWORLD-SLS-GPU_CPU, GrayCode.cpp, ImageFileProcessor.cpp",
        with_ends(pairs, first=True),
    ),
    FrameLayout(
        "sltk",
        "jhdewitt/sltk",
        "https://github.com/jhdewitt/sltk, sampledata/scan_0020/list.yaml",
        (_sltk,),
        names=_sltk_names,
    ),
    FrameLayout(
        "slstudio-gray",
        "SLStudio, Gray code",
        "https://github.com/jakobwilm/slstudio, src/codec/CodecGrayCode.cpp",
        tuple(_slstudio_gray(*axes) for axes in _BOTH),
    ),
    FrameLayout(
        "slstudio-2x3",
        "SLStudio, two fringes in three steps",
        "https://github.com/jakobwilm/slstudio, src/codec/CodecPhaseShift2x3.cpp, pstools.cpp",
        tuple(_slstudio_fringes(16, 3, *axes) for axes in _BOTH),
        needs=("projector_size",),
    ),
    FrameLayout(
        "slstudio-nstep",
        "SLStudio, a fringe in nine steps and one in three",
        "https://github.com/jakobwilm/slstudio, src/codec/CodecPhaseShiftNStep.cpp, pstools.cpp",
        tuple(_slstudio_fringes(8, 9, *axes) for axes in _BOTH),
        needs=("projector_size",),
    ),
    FrameLayout(
        "gray",
        "Gray code in another order",
        "docs/import.md",
        other_gray_orders(),
        last=True,
    ),
)
