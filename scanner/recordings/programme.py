"""The schedule of a sequence's video: a start mark before each loop and after the last one; all pictures equally long.

The start mark is a rhythm of white and black fields. It needs no geometry: the pictures are decoded in pixels of the
video, so that scaling by the player only resamples them, and a mirrored picture shows in the decoded coordinates.

Writing a sequence as a video that players show: H.264, 4:2:0, constant rate, nearly lossless.
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from calib.geometry import SQUARE_PIXELS, PixelGrid, Size
from scanner.errors import InputError
from scanner.io import Entry, Number, Whole, read_yaml, validate
from scanner.patterns import FORMAT, Pattern, PatternEntry, draw, pattern_to_dict
from scanner.recordings.video_file import av

FRAMES_PER_SECOND = 60  # a projector of 60 Hz shows it without judder
WHITE, BLACK = -1, -2
# Barker code of length seven: its autocorrelation has no side peaks (Barker, 1953).
_RHYTHM = (1, 1, 1, 0, 0, 1, 0)
LONGEST_WHITE = 2  # the slot of a mark that is white and has white before and after it
_ID_BITS = 8
_SHORTEST_S, _LONGEST_S, _MOST_LOOPS = 0.05, 10.0, 20
LEAD_IN_S, LEAD_OUT_S = 2.0, 1.0  # black: players show their buttons at the beginning
CONTAINERS = (".mp4", ".mov", ".mkv")
# At this quality, grey levels err by one or two; few players support lossless H.264.
_QUANTISER = "4"
_BLACK_LEVEL, _LEVELS = 16, 219  # luma range (ITU-R BT.709); players may not support others
_NO_COLOUR = 128
_LIMITED_RANGE, _BT_709 = 1, 1


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
        listed = "".join(str(pattern_to_dict(pattern)) for pattern in self.patterns)
        number = zlib.crc32(f"{tuple(self.size)} {listed}".encode()) % (1 << _ID_BITS)
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


def write_player_video(path: Path, programme: Programme) -> None:
    """A picture with an odd side gets another row or column. Raises InputError if PyAV is missing."""
    width, height = (side + side % 2 for side in programme.grid.device_size(programme.size))
    library = av()
    with library.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FRAMES_PER_SECOND)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"qp": _QUANTISER, "preset": "medium", "bf": "0", "g": str(FRAMES_PER_SECOND)}
        context = stream.codec_context
        context.color_range, context.colorspace = _LIMITED_RANGE, _BT_709
        context.color_primaries, context.color_trc = _BT_709, _BT_709
        number = 0
        for picture, frames in _pictures(programme):
            padded = np.pad(np.asarray(programme.grid.sample(picture), np.float64), [(0, 1)] * 2, mode="edge")[
                :height, :width
            ]
            luma = np.rint(_BLACK_LEVEL + padded * (_LEVELS / 255)).astype(np.uint8)
            planes = np.concatenate([luma, np.full((height // 2, width), _NO_COLOUR, np.uint8)])
            for _ in range(frames):
                frame = library.VideoFrame.from_ndarray(planes, format="yuv420p")
                frame.pts, frame.color_range = number, _LIMITED_RANGE
                number += 1
                container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _pictures(programme: Programme) -> Iterator[tuple[NDArray[np.uint8], int]]:
    """Yield each picture, and for how many frames it is shown."""
    width, height = programme.size
    fields = {WHITE: np.full((height, width), 255, np.uint8), BLACK: np.zeros((height, width), np.uint8)}
    hold = round(programme.hold_s * FRAMES_PER_SECOND)
    yield fields[BLACK], round(LEAD_IN_S * FRAMES_PER_SECOND)
    for slot in programme.slots:
        yield fields[slot] if slot in fields else draw(programme.patterns[slot], programme.size), hold
    yield fields[BLACK], round(LEAD_OUT_S * FRAMES_PER_SECOND)
