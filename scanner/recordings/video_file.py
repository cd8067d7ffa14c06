"""Reading a recording: the luma of its frames with their times, and the camera's tone curve, which gives the light of
each code.

libav by itself chooses among some 300 formats, of which playlists and descriptions of streams name further files and
addresses. Here it is told the container, gets an open file instead of a name, and may open no other.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import monotonic
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Size
from calib.numerics import Floats, Image
from hw.optional_parts import VIDEO
from scanner.errors import InputError
from scanner.io import MOST_PIXELS, opened
from scanner.shown_text import shown

_SRGB_EXPONENT, _SRGB_TOE = 2.4, 0.055
_CLIPPED = 0.985  # share of the range of codes; compression keeps nothing exactly at the end
_KINDS = "mp4, mov, mkv, webm, avi"
# The demuxer of files that have these bytes at this place (ISO/IEC 14496-12, QuickTime File Format, RFC 9559, RIFF).
_CONTAINERS = (
    ("mov", 4, (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")),
    ("matroska", 0, (b"\x1a\x45\xdf\xa3",)),
    ("avi", 8, (b"AVI ",)),
)
_HEAD_BYTES = 12
FRAME_LIMITS = {"max_pixels": str(MOST_PIXELS)}  # of libav's decoders
_LONGEST_WAIT_S = 60.0  # for a frame; films of 4K take a hundredth of it
_FULL_RANGE = 2
_PER_SECOND = 1_000_000  # of the container's duration
_FEWEST_FRAMES = 10
# A film of a video begins before it, ends after it, and may show it slower; more frames tell nothing more.
_MOST_LENGTHS, _AROUND_S, _MOST_FRAMES = 2, 120.0, 100_000
_LUMA_FIRST = ("yuv", "nv", "gray", "p0")  # formats whose first plane is luma


@dataclass(frozen=True)
class ToneCurve:
    """Light is ((v + a) / (1 + a)) ** exponent of a level v from 0 to 1 that an S of strength `contrast` was taken off.

    Exponent 2.4 without contrast is sRGB but for its toe (IEC 61966-2-1); a is proportional to the exponent less one,
    so that 1 is linear. `contrast` from −0.9 to 0.9 keeps the curve monotonic.
    """

    exponent: float = _SRGB_EXPONENT
    contrast: float = 0.0

    def light(self, level: Floats) -> Floats:
        """From 0 for the level 0 to 1 for the level 1."""
        straight = level - self.contrast * level * (1 - level) * (2 * level - 1)
        toe = _SRGB_TOE * (self.exponent - 1) / (_SRGB_EXPONENT - 1)
        black = (toe / (1 + toe)) ** self.exponent if toe > 0 else 0.0
        return (((straight + toe) / (1 + toe)) ** self.exponent - black) / (1 - black)


@dataclass(frozen=True)
class LumaCodes:
    """Codes of luma, of which `black` and `white` are the ends."""

    black: int
    white: int

    @cached_property
    def levels(self) -> Floats:
        """(codes,): 0 to 1, clipped."""
        highest = 255
        while highest < self.white:
            highest = 2 * highest + 1
        return np.clip((np.arange(highest + 1) - self.black) / (self.white - self.black), 0, 1)

    def light(self, curve: ToneCurve) -> NDArray[np.float32]:
        """(codes,): the light of each; exactly 1 where it was clipped."""
        light = np.where(self.levels >= _CLIPPED, 1.0, curve.light(self.levels))
        return light.astype(np.float32)


def av() -> ModuleType:
    """Raise InputError that names the extra if PyAV cannot be imported."""
    with VIDEO.needed("video", "av", InputError):
        import av as library
    library.logging.set_level(library.logging.PANIC)  # errors of a file are raised as exceptions instead
    module: ModuleType = library
    return module


class _InterruptedError(Exception):
    """A KeyboardInterrupt on its way through libav, which would drop it."""


class FilmBytes:
    """An open recording, read by libav in pieces. `waits_since`: when the last frame came, of `monotonic`."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file
        self._interrupted = False
        self.waits_since = monotonic()

    def read(self, count: int) -> bytes:
        """Up to `count` bytes. Raises InputError if no frame came for long, _InterruptedError for Ctrl-C."""
        if self._interrupted:
            return b""
        if monotonic() - self.waits_since > _LONGEST_WAIT_S:
            raise InputError(
                f"{self._path}: no frame came in {_LONGEST_WAIT_S:.0f} s: expected a recording ({_KINDS}) on a disk "
                "that answers; copy it to this computer, whole"
            )
        try:
            return self._file.read(count)
        except KeyboardInterrupt as error:
            self._interrupted = True
            raise _InterruptedError from error

    def seek(self, offset: int, whence: int) -> int:
        """The new position."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """The position."""
        return self._file.tell()


@contextmanager
def opened_film(path: Path) -> Iterator[tuple[Any, FilmBytes]]:
    """libav's container of a recording, and its bytes.

    Raises InputError for a file that is no regular one, is in another container, refers to others, or is damaged.
    """
    library = av()

    def refuse_reference(address: str, _flags: int, _options: dict[str, str]) -> None:
        raise InputError(f"{path}: expected a recording that is complete, found one that refers to {shown(address)}")

    with opened(path) as file:
        demuxer = _demuxer(path, file.read(_HEAD_BYTES))
        file.seek(0)
        film = FilmBytes(path, file)
        try:
            with library.open(
                film,
                "r",
                format=demuxer,
                options=FRAME_LIMITS,
                container_options={"protocol_whitelist": "file"},
                io_open=refuse_reference,
            ) as container:
                yield container, film
        except _InterruptedError as error:
            raise KeyboardInterrupt from error
        except (library.FFmpegError, UnicodeDecodeError) as error:
            raise InputError(
                f"{path}: expected a recording ({_KINDS}), found a file that cannot be read as one "
                f"({getattr(error, 'strerror', None) or error}): copy the file again, whole"
            ) from error


def _demuxer(path: Path, head: bytes) -> str:
    for demuxer, offset, marks in _CONTAINERS:
        if head[offset:].startswith(marks):
            return demuxer
    raise InputError(
        f"{path}: expected a recording ({_KINDS}), found a file that cannot be read as one: it is of another kind; "
        "convert it, with all its frames"
    )


@dataclass(frozen=True)
class VideoFile:
    """A readable recording."""

    path: Path
    size: Size
    """As coded, before rotation by `quarter_turns` counterclockwise."""
    quarter_turns: int
    codes: LumaCodes
    """Of its luma."""
    expected_frames: int
    """As stated in the file, 0 if not."""
    shown_s: float
    """Duration of the video that was filmed."""

    def frames(self) -> Iterator[tuple[float, Image]]:
        """Yield time in seconds and luma (H, W), 8 or 16 bit, of each frame in order of time; of very many frames, of
        some, evenly.

        Raises InputError if a frame is of another size or interlaced, or if they go on for too long for a film of the
        video. A truncated file is read as far as possible.
        """
        with opened_film(self.path) as (container, film):
            stream = _video_stream(self.path, container)
            stream.thread_type = "AUTO"
            per_frame = 1 / float(stream.average_rate or 30)
            longest_s = _longest_s(self.shown_s)
            first, last = np.nan, -np.inf
            for number, frame in enumerate(_decoded(container, stream, film)):
                if (frame.width, frame.height) != self.size:
                    raise InputError(
                        f"{self.path}: expected frames of {self.size}, found {frame.width} × {frame.height}"
                    )
                if frame.interlaced_frame:
                    raise InputError(f"{self.path}: is interlaced: record progressive frames, as in 1080p")
                time_s = frame.time if frame.time is not None else number * per_frame
                first = np.fmin(first, time_s)
                _refuse_longer(self.path, float(time_s - first), self.shown_s)
                # A frame of the same time is a repeat.
                if time_s > last and time_s >= last + longest_s / _MOST_FRAMES:
                    last = time_s
                    yield float(time_s), _luma(frame)


def open_video(path: Path, shown_s: float) -> VideoFile:
    """Open a film of a video that takes `shown_s`, and read its first frames. Raises InputError for other files."""
    with opened_film(path) as (container, film):
        stream = _video_stream(path, container)
        _refuse_longer(path, (container.duration or 0) / _PER_SECOND, shown_s)
        frames = _decoded(container, stream, film)
        first = next(frames, None)
        if first is None:
            raise InputError(f"{path}: no frame can be read: copy the file again, or record again")
        count = 1 + sum(1 for _, _ in zip(range(_FEWEST_FRAMES - 1), frames, strict=False))
        if count < _FEWEST_FRAMES:
            raise InputError(f"{path}: expected a recording, found {count} frame{'s' * (count > 1)}: is it a still?")
        bits = _bits(first)
        full = first.color_range == _FULL_RANGE or first.format.name.startswith("yuvj")
        scale = 1 << bits - 8
        black, white = (0, 255 * scale + scale - 1) if full else (16 * scale, 235 * scale)
        turns = round((first.rotation or 0) / 90) % 4
        return VideoFile(
            path, Size(first.width, first.height), turns, LumaCodes(black, white), stream.frames or 0, shown_s
        )


def _longest_s(shown_s: float) -> float:
    """The duration of the longest film of a video that takes `shown_s`."""
    return _MOST_LENGTHS * shown_s + _AROUND_S


def _refuse_longer(path: Path, length_s: float, shown_s: float) -> None:
    if length_s > _longest_s(shown_s):
        raise InputError(
            f"{path}: takes {length_s:.0f} s or more, and its video {shown_s:.0f} s; expected a film of no more than "
            f"{_longest_s(shown_s):.0f} s: cut off what is before and after the video; if this is slow motion, film at "
            "normal speed"
        )


def _video_stream(path: Path, container: Any) -> Any:
    if not container.streams.video:
        raise InputError(f"{path}: expected a recording, found a file without pictures")
    stream = container.streams.video[0]
    if stream.codec_context is None:
        raise InputError(f"{path}: expected a recording, found pictures in a code that is not known here")
    stream.codec_context.options = FRAME_LIMITS
    return stream


def _decoded(container: Any, stream: Any, film: FilmBytes) -> Iterator[Any]:
    """The frames up to the first that cannot be read, where a file was cut off."""
    library = av()
    any_yet = False
    try:
        for frame in container.decode(stream):
            any_yet = True
            film.waits_since = monotonic()
            yield frame
    except library.FFmpegError:
        if not any_yet:
            raise


def _bits(frame: Any) -> int:
    return int(frame.format.components[0].bits) if frame.format.name.startswith(_LUMA_FIRST) else 8


def _luma(frame: Any) -> Image:
    """(H, W); colours that are no luma and chroma are converted."""
    name = frame.format.name
    if not name.startswith(_LUMA_FIRST):
        frame = frame.reformat(format="yuv420p")
    plane, bits = frame.planes[0], _bits(frame)
    shape = -1, plane.line_size // (2 if bits > 8 else 1)
    if bits == 8:
        return np.frombuffer(plane, np.uint8).reshape(shape)[: frame.height, : frame.width]
    rows = np.frombuffer(plane, np.uint16).reshape(shape)[: frame.height, : frame.width]
    return rows >> np.uint16(16 - bits) if name.startswith("p0") else rows  # the bits are the upper ones there
