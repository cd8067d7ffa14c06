"""The schedule of a sequence's video: a start mark before each loop and after the last one; all pictures equally long.

The start mark is a rhythm of white and black fields. It needs no geometry: the pictures are decoded in pixels of the
video, so that scaling by the player only resamples them, and a mirrored picture shows in the decoded coordinates.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from pathlib import Path

from pydantic import Field

from calib.geometry import SQUARE_PIXELS, PixelGrid, Size
from scanner.errors import InputError
from scanner.io import Entry, Number, Whole, read_yaml, validate
from scanner.patterns import FORMAT, Pattern, PatternEntry, pattern_to_dict

FRAMES_PER_SECOND = 60  # a projector of 60 Hz shows it without judder
WHITE, BLACK = -1, -2
# Barker code of length seven: its autocorrelation has no side peaks (Barker, 1953).
_RHYTHM = (1, 1, 1, 0, 0, 1, 0)
LONGEST_WHITE = 2  # the slot of a mark that is white and has white before and after it
_ID_BITS = 8
_SHORTEST_S, _LONGEST_S, _MOST_LOOPS = 0.05, 10.0, 20
LEAD_IN_S, LEAD_OUT_S = 2.0, 1.0  # black: players show their buttons at the beginning


@dataclass(frozen=True)
class Programme:
    """Patterns for a projector of `size`, each shown for `hold_s`, all of them there and back `loops` times.

    `size` and patterns are in square pixels, those of the video form a `grid`.

    Raises ValueError for a duration or a number of loops that no video has.
    """

    patterns: tuple[Pattern, ...]
    size: Size
    hold_s: float
    loops: int
    grid: PixelGrid = SQUARE_PIXELS

    def __post_init__(self) -> None:
        _require_duration(self.hold_s)
        if not 1 <= self.loops <= _MOST_LOOPS:
            raise ValueError(f"expected 1 to {_MOST_LOOPS} loops, found {self.loops}")

    @cached_property
    def mark(self) -> tuple[int, ...]:
        """The start mark: WHITE or BLACK in each slot of `hold_s`. Its last bits identify the sequence."""
        shown = "".join(str(pattern_to_dict(pattern)) for pattern in self.patterns)
        number = zlib.crc32(f"{tuple(self.size)} {shown}".encode()) % (1 << _ID_BITS)
        bits = (0, *_RHYTHM, *(number >> bit & 1 for bit in range(_ID_BITS)), 0)
        return tuple(WHITE if bit else BLACK for bit in bits)

    @cached_property
    def rhythm_slots(self) -> int:
        """The number of slots of the mark that are the same for every sequence."""
        return 1 + len(_RHYTHM)

    @cached_property
    def loop(self) -> tuple[int, ...]:
        """Return the contents of each slot from a start mark to the end of the next: WHITE, BLACK, or a pattern's
        number.

        The patterns run forwards, then backwards. Encoders, temporal denoising in cameras, and slow panels leave a
        share of each picture in the next one (ghosting). That shifts fringes of successive steps to one side, and to
        the other side in reverse order. All pictures are shown at the same time on average, so that slow drift shifts
        none of them against another.
        """
        there = range(len(self.patterns))
        return (*self.mark, *there, *reversed(there), *self.mark)

    @property
    def turn(self) -> int:
        """The slot of a loop from which its patterns are in reverse order."""
        return len(self.mark) + len(self.patterns)

    def slots_of(self, pattern: int) -> tuple[int, int]:
        """Return the slots in a loop that show a pattern: forwards and backwards."""
        return len(self.mark) + pattern, 2 * self.turn - len(self.mark) - 1 - pattern

    @property
    def slots_between_marks(self) -> int:
        """Return the slots from the beginning of a mark to that of the next."""
        return len(self.loop) - len(self.mark)

    @property
    def slots(self) -> tuple[int, ...]:
        """Return the contents of the whole video, without the black before and after it."""
        return self.loops * self.loop[: self.slots_between_marks] + self.mark

    @property
    def length_s(self) -> float:
        """The duration of the video."""
        return LEAD_IN_S + len(self.slots) * self.hold_s + LEAD_OUT_S

    def as_dict(self, file: str) -> dict[str, object]:
        """Return the entry of `sequence.yaml` that describes a video."""
        return {"file": file, "frames_per_second": FRAMES_PER_SECOND, "hold_s": self.hold_s, "loops": self.loops}


def programme_of(
    patterns: Sequence[Pattern], size: Size, hold_s: float, loops: int, grid: PixelGrid = SQUARE_PIXELS
) -> Programme:
    """Return a schedule whose pictures last a whole number of video frames, and `hold_s` at least. Raises ValueError.

    The number of frames is odd: a camera at half the frame rate then meets changes at two phases of its frames.
    Otherwise exposure and line time could not be separated from the phase between the clocks.
    """
    _require_duration(hold_s)
    frames = ceil(hold_s * FRAMES_PER_SECOND - 1e-6) | 1
    return Programme(tuple(patterns), size, frames / FRAMES_PER_SECOND, loops, grid)


def _require_duration(hold_s: float) -> None:
    if not _SHORTEST_S - 1e-6 <= hold_s <= _LONGEST_S + 1 / FRAMES_PER_SECOND:
        raise ValueError(f"expected {_SHORTEST_S:g} to {_LONGEST_S:g} seconds for a picture, found {hold_s:g}")


class _Sides(Entry):
    width: Whole = Field(ge=2)
    height: Whole = Field(ge=2)


class _Shown(Entry):
    pattern: PatternEntry


class _Video(Entry):
    hold_s: Number
    loops: Whole


class _SequenceEntry(Entry):
    format: Whole = Field(ge=FORMAT, le=FORMAT)
    projector: _Sides
    pixel_aspect: Number = Field(default=1.0, gt=0)
    frames: list[_Shown] = Field(min_length=1)
    video: _Video


def read_programme(path: Path) -> Programme:
    """Read the schedule that `scan patterns --video` wrote beside its video. Raises InputError."""
    data = read_yaml(path)
    if isinstance(data, dict) and "video" not in data:
        raise InputError(f"{path}: expected the sequence.yaml of a video, as scan patterns --video writes it")
    entry = validate(_SequenceEntry, data, str(path))
    patterns = tuple(frame.pattern.pattern() for frame in entry.frames)
    try:
        size = Size(entry.projector.width, entry.projector.height)
        return Programme(patterns, size, entry.video.hold_s, entry.video.loops, PixelGrid(entry.pixel_aspect))
    except ValueError as error:
        raise InputError(f"{path}: video: {error}") from error
