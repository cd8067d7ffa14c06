"""The bytes of a recording as libav may have them: of one regular file in an allowed container, and of nothing else.

libav by itself chooses among some 300 formats, of which playlists and descriptions of streams name further files and
addresses. Here it is told the container, gets an open file instead of a name, and may open no other.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any, BinaryIO

from scanner.errors import InputError
from scanner.io import MOST_PIXELS, opened
from scanner.recordings.libav import av
from scanner.shown_text import shown

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
