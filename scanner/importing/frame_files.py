"""The images of a folder that may be the frames of one capture, in the order of their numbers."""

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

from calib.numerics import Image
from scanner.errors import InputError
from scanner.io import SUFFIXES, read_image
from scanner.patterns import Axis

_FEWEST = 3
_LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
_NUMBER = re.compile(r"\d+")
# A time stamp, to the second or finer, with any separators.
_MOMENT = re.compile(r"(?<!\d)(?:19|20)\d\d(?:[-_.]?\d\d){2}\D{1,4}\d\d(?:[-_.:h]?\d\d){2}(?:[-_.,]?\d{1,6})?(?!\d)")
_COPY = re.compile(r" ?\(#\)(?=\.)")  # number of a copy
_NAMES = {"white": ("white", "lit", "light", "on"), "black": ("black", "unlit", "dark", "off")}


@dataclass(frozen=True)
class FrameFiles:
    """`numbered` frames in order; `white` and `black`, where files are called so; `left_out`: the others."""

    folder: Path
    numbered: tuple[Path, ...]
    white: Path | None = None
    black: Path | None = None
    left_out: tuple[Path, ...] = ()

    def without(self, frames: Collection[Path]) -> "FrameFiles":
        """The same with some of the numbered frames left out."""
        kept = tuple(path for path in self.numbered if path not in frames)
        return replace(self, numbered=kept, left_out=(*self.left_out, *frames))

    def __str__(self) -> str:
        named = [path.name for path in (self.white, self.black) if path]
        return " and ".join([f"{len(self.numbered)} frames, {_span(self.numbered)}", *named])


def read_frame(path: Path, flip: Axis | None) -> Image:
    """An image, mirrored back left to right (`flip` x) or top to bottom (y). Raises InputError."""
    image = read_image(path)
    if flip is None:
        return image
    return image[:, ::-1].copy() if flip == "x" else image[::-1].copy()


def find_frames(folder: Path, pattern: str | None = None) -> FrameFiles:
    """The frames in a folder, or in its only sub-folder with images; `pattern` selects names.

    Names of a series differ in their last number only, or in their numbers, or in a time stamp. Numbers may have gaps
    and any number of digits. Raises InputError without a series of at least three, or with several.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder with images, found {'a file' if folder.exists() else 'nothing'}")
    place, images = _place_of_images(folder, pattern or "*")
    last, every, moments = (_largest(images, partial(_shape, part)) for part in (_LAST_NUMBER, _NUMBER, _MOMENT))
    series = last or every
    # Time-stamped names have a series of last numbers per minute.
    if len(moments) == 1 and series and len(moments[0]) > len(series[0]):
        series = moments
    if not series:
        names = ", ".join(path.name for path in images[:5])
        raise InputError(
            f"{place}: expected a series of at least {_FEWEST} numbered images, found {len(images)} images ({names})"
        )
    if len(series) > 1:
        series_text = "; ".join(f"{len(frame_series)} frames, {_span(frame_series)}" for frame_series in series)
        raise InputError(
            f"{place}: expected the frames of one camera, found several series: {series_text}; name one, as with "
            f"--frames '{_LAST_NUMBER.sub('*', series[0][0].name)}'"
        )
    frames = [*_without_number(images, series[0]), *series[0]]
    rest = [path for path in images if path not in frames]
    white, black = (_named(rest, role) for role in ("white", "black"))
    left_out = tuple(path for path in rest if path not in (white, black))
    return FrameFiles(place, tuple(frames), white, black, left_out)


def _place_of_images(folder: Path, pattern: str) -> tuple[Path, list[Path]]:
    images = _images_in(folder, pattern)
    if len(images) >= _FEWEST:
        return folder, images
    inner = {place: _images_in(place, pattern) for place in sorted(folder.iterdir()) if place.is_dir()}
    inner = {place: inner_images for place, inner_images in inner.items() if len(inner_images) >= _FEWEST}
    if not inner:
        raise InputError(f"{folder}: expected the frames of a capture, found {len(images)} images")
    if len(inner) > 1:
        names = ", ".join(str(place) for place in inner)
        raise InputError(f"{folder}: expected the frames of one capture, found several folders of images: {names}")
    ((place, inner_images),) = inner.items()
    return place, inner_images + images


def _images_in(folder: Path, pattern: str) -> list[Path]:
    image_files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    return sorted(
        (path for path in image_files if fnmatch(path.name, pattern) and not path.name.startswith(".")), key=_natural
    )


def _natural(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Names by their numbers' values: 2 before 10."""
    parts = re.split(r"(\d+)", path.stem)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts], path.name


def _shape(numbers: re.Pattern[str], path: Path) -> str | None:
    """A name with its numbers replaced; None without numbers."""
    stem, count = numbers.subn("#", path.stem)
    return stem + path.suffix.lower() if count else None


def _largest(paths: Iterable[Path], key: Callable[[Path], Hashable | None]) -> list[list[Path]]:
    """The largest groups of paths with the same key: several if they are equally large, none if they are too small."""
    groups: dict[Hashable, list[Path]] = defaultdict(list)
    for path in paths:
        if (of_path := key(path)) is not None:
            groups[of_path].append(path)
    most = max((len(group) for group in groups.values()), default=0)
    return [group for group in groups.values() if len(group) == most >= _FEWEST]


def _without_number(images: Iterable[Path], series: list[Path]) -> list[Path]:
    """The first of a series like 'frame.png', 'frame (1).png', 'frame (2).png'."""
    shape = _shape(_LAST_NUMBER, series[0])
    name = None if shape is None or not _COPY.search(shape) else _COPY.sub("", shape)
    return [path for path in images if path.stem + path.suffix.lower() == name]


def _named(paths: Iterable[Path], role: str) -> Path | None:
    words = _NAMES[role]
    matching = [path for path in paths if set(re.split(r"[^a-z]+", path.stem.lower())) & set(words)]
    return matching[0] if len(matching) == 1 else None


def _span(paths: tuple[Path, ...] | list[Path]) -> str:
    return f"{paths[0].name} to {paths[-1].name}"
