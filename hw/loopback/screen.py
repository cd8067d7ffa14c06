"""What a virtual screen shows, and showed a moment ago.

`Xvfb -fbdir` keeps the screen in a memory-mapped file in the format of xwd (X11/XWDFile.h), which anyone may read.
"""

import mmap
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Image

_HEADER_WORDS = 25
_COLOUR_ENTRY_BYTES = 12
_POLL_S = 0.002
_MEMORY_S = 3.0


class XwdScreen:
    """The pixels of a screen of 24 bits in a file that its X server keeps up to date.

    Raises ValueError if the file is something else, OSError if it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        header = np.frombuffer(self._memory, ">u4", _HEADER_WORDS)
        header_bytes, version, width, height = (int(header[k]) for k in (0, 1, 4, 5))
        bits_per_pixel, bytes_per_line, colours = (int(header[k]) for k in (11, 12, 19))
        if version != 7 or bits_per_pixel != 32:
            raise ValueError(f"{path}: expected an xwd file, version 7, 32 bits, found {version}, {bits_per_pixel} bits")
        self.size = (width, height)
        start = header_bytes + colours * _COLOUR_ENTRY_BYTES
        lines = np.frombuffer(self._memory, np.uint8, bytes_per_line * height, start).reshape(height, bytes_per_line)
        self._pixels: NDArray[np.uint32] = lines[:, : 4 * width].view(np.uint32)

    def pixels(self) -> NDArray[np.uint32]:
        """A copy of what the screen shows now, (H, W), blue in the lowest byte."""
        return self._pixels.copy()


def green(pixels: NDArray[np.uint32]) -> Image:
    """The green channel, (H, W) 8-bit; a projector of patterns shows grey, in which all channels are alike."""
    return ((pixels >> 8) & 0xFF).astype(np.uint8)


class Pixels(Protocol):
    """A screen that can be looked at."""

    def pixels(self) -> NDArray[np.uint32]:
        """A copy of what it shows now."""


@dataclass(frozen=True)
class Picture:
    """What the screen showed from `since_s` on (monotonic clock)."""

    since_s: float
    image: Image


class ScreenHistory:
    """The pictures of the last seconds, seen by looking every 2 ms while the `with` block runs.

    A change is dated back to the last look that did not show it yet. So the light of a new picture is at most one look
    early, however late the machine lets us look; it never falls into an exposure that was over before the change.
    """

    def __init__(self, screen: Pixels) -> None:
        self._screen = screen
        self._last = screen.pixels()
        self._looked_s = time.monotonic()
        self._pictures = deque([Picture(self._looked_s, green(self._last))])
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def look(self) -> None:
        """Take note of what the screen shows now."""
        with self._lock:
            now_s = time.monotonic()
            pixels = self._screen.pixels()
            if not np.array_equal(pixels, self._last):
                self._last = pixels
                self._pictures.append(Picture(self._looked_s, green(pixels)))
                while len(self._pictures) > 1 and self._pictures[1].since_s < now_s - _MEMORY_S:
                    self._pictures.popleft()
            self._looked_s = now_s

    def shares(self, begin_s: float, end_s: float) -> list[tuple[float, Image]]:
        """The pictures shown between two moments, each with its share of the time; the shares add up to one."""
        with self._lock:
            pictures = list(self._pictures)
        until = [*(picture.since_s for picture in pictures[1:]), float("inf")]
        since = [float("-inf"), *(picture.since_s for picture in pictures[1:])]
        shown = [max(0.0, min(last, end_s) - max(first, begin_s)) for first, last in zip(since, until, strict=True)]
        total_s = end_s - begin_s
        return [(part / total_s, picture.image) for part, picture in zip(shown, pictures, strict=True) if part > 0]

    def _watch(self) -> None:
        while not self._ending.wait(_POLL_S):
            self.look()
