"""The images of a folder that may be the frames of one capture, in the order of their numbers."""

import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from scanner.errors import InputError
from scanner.io import SUFFIXES

_FEWEST = 3
_LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
_NUMBER = re.compile(r"\d+")
_NAMES = {"white": ("white", "lit", "light", "on"), "black": ("black", "unlit", "dark", "off")}


@dataclass(frozen=True)
class FrameFiles:
    """`numbered` frames in order; `white` and `black`, where files are called so; `left_out`: the others."""

    folder: Path
    numbered: tuple[Path, ...]
    white: Path | None = None
    black: Path | None = None
    left_out: tuple[Path, ...] = ()

    def __str__(self) -> str:
        named = [path.name for path in (self.white, self.black) if path]
        return " and ".join([f"{len(self.numbered)} frames, {_span(self.numbered)}", *named])


def find_frames(folder: Path, pattern: str | None = None) -> FrameFiles:
    """The frames in a folder, or in its only sub-folder that has images; of all names only those like `pattern`.

    A series is what differs in its last number only, or else in its numbers; numbers may be missing, and have any
    number of digits. Raises InputError where there is no series of at least three, or more than one.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder with images, found {'a file' if folder.exists() else 'nothing'}")
    place, images = _place_of_images(folder, pattern or "*")
    series = _largest(images, lambda path: _shape(_LAST_NUMBER, path)) or _largest(
        images, lambda path: _shape(_NUMBER, path)
    )
    if not series:
        names = ", ".join(path.name for path in images[:5])
        raise InputError(
            f"{place}: expected a series of at least {_FEWEST} numbered images, found {len(images)} images ({names})"
        )
    if len(series) > 1:
        found = "; ".join(f"{len(one)} frames, {_span(one)}" for one in series)
        raise InputError(
            f"{place}: expected the frames of one camera, found several series: {found}; name one, as with "
            f"--frames '{_LAST_NUMBER.sub('*', series[0][0].name)}'"
        )
    rest = [path for path in images if path not in series[0]]
    white, black = (_named(rest, role) for role in ("white", "black"))
    left_out = tuple(path for path in rest if path not in (white, black))
    return FrameFiles(place, tuple(series[0]), white, black, left_out)


def _place_of_images(folder: Path, pattern: str) -> tuple[Path, list[Path]]:
    images = _images_in(folder, pattern)
    if len(images) >= _FEWEST:
        return folder, images
    inner = {place: _images_in(place, pattern) for place in sorted(folder.iterdir()) if place.is_dir()}
    inner = {place: found for place, found in inner.items() if len(found) >= _FEWEST}
    if not inner:
        raise InputError(f"{folder}: expected the frames of a capture, found {len(images)} images")
    if len(inner) > 1:
        names = ", ".join(str(place) for place in inner)
        raise InputError(f"{folder}: expected the frames of one capture, found several folders of images: {names}")
    ((place, found),) = inner.items()
    return place, found + images


def _images_in(folder: Path, pattern: str) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    return sorted(
        (path for path in found if fnmatch(path.name, pattern) and not path.name.startswith(".")), key=_natural
    )


def _natural(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Names by their numbers' values: 2 before 10."""
    parts = re.split(r"(\d+)", path.stem)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts], path.name


def _shape(numbers: re.Pattern[str], path: Path) -> str | None:
    """A name without its numbers; None if there are none."""
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


def _named(paths: Iterable[Path], role: str) -> Path | None:
    words = _NAMES[role]
    found = [path for path in paths if set(re.split(r"[^a-z]+", path.stem.lower())) & set(words)]
    return found[0] if len(found) == 1 else None


def _span(paths: tuple[Path, ...] | list[Path]) -> str:
    return f"{paths[0].name} to {paths[-1].name}"
