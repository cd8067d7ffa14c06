"""Reads a virtual screen, and keeps a history of what it showed.

`Xvfb -fbdir` keeps the screen in a memory-mapped file in the format of xwd (X11/XWDFile.h).

The light path from a screen to the wall: latency with jitter for each picture, and panels that settle slowly.
"""

import mmap
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image
from hw.loopback.settings import Conditions
from hw.simulated import Light

_MEMORY_S = 3.0
_REFRESH_S = 1 / 60
_HEADER_WORDS = 25
_COLOUR_ENTRY_BYTES = 12
_POLL_S = 0.002
_REDRAWN_S = 0.001  # about how long a swap of buffers takes to be copied to the screen


@dataclass(frozen=True)
class PictureChange:
    """From `since_s` on (monotonic clock) the wall changes to this light, which may still be rendering."""

    since_s: float
    light: Future[Light]


class Wall:
    """The present and coming light of the room, under `conditions` that may change."""

    def __init__(self, light: Future[Light], seed: int) -> None:
        self.conditions = Conditions(latency_ms=0.0)
        self._pictures = deque([PictureChange(-np.inf, light)])
        self._rng = np.random.default_rng(seed)

    def send(self, shown_s: float, light: Future[Light]) -> None:
        """Add a picture that the screen shows from `shown_s` on; pictures reach the wall in order."""
        how = self.conditions
        delay_s = (how.latency_ms + how.jitter_ms * self._rng.random()) / 1e3
        delay_s += _REFRESH_S * (self._rng.random() < how.missed_refreshes)
        self._pictures.append(PictureChange(max(shown_s + delay_s, self._pictures[-1].since_s), light))
        while self._pictures[1].since_s < shown_s - _MEMORY_S:
            self._pictures.popleft()

    def shares(self, begin_s: float, end_s: float) -> list[tuple[float, Future[Light]]]:
        """The light of each picture between two times, with its share; shares sum to one."""
        pictures = list(self._pictures)
        until = [*(picture.since_s for picture in pictures[1:]), np.inf]
        seconds, before = np.zeros(len(pictures)), np.zeros(len(pictures))
        for number, (picture, last_s) in enumerate(zip(pictures, until, strict=True)):
            first_s, stop_s = max(picture.since_s, begin_s), min(last_s, end_s)
            if stop_s > first_s:
                remaining, later = self._left(picture.since_s, first_s), self._left(picture.since_s, stop_s)
                faded_s = self.conditions.settling_ms / 1e3 * (remaining - later)
                seconds += faded_s * before
                seconds[number] += stop_s - first_s - faded_s * before.sum()
            before *= self._left(picture.since_s, last_s)
            before[number] += 1 - before.sum()
        shares = seconds / (end_s - begin_s)
        return [(float(share), picture.light) for share, picture in zip(shares, pictures, strict=True) if share > 0]

    def _left(self, since_s: float, now_s: float) -> float:
        """The remaining share of the old light, `now_s` − `since_s` after the next picture arrived."""
        settling_s = self.conditions.settling_ms / 1e3
        return float(np.exp((since_s - now_s) / settling_s)) if settling_s and np.isfinite(since_s) else 0.0


class XwdScreen:
    """The pixels of a screen with 24 bits, in a file that its X server updates.

    Raises ValueError if the file has another format, OSError if it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        header = np.frombuffer(self._memory, ">u4", _HEADER_WORDS)
        header_bytes, version, width, height = (int(header[k]) for k in (0, 1, 4, 5))
        bits_per_pixel, bytes_per_line, colours = (int(header[k]) for k in (11, 12, 19))
        if version != 7 or bits_per_pixel != 32:
            raise ValueError(f"{path}: expected xwd version 7 with 32 bits, found {version} with {bits_per_pixel}")
        self.size = (width, height)
        start = header_bytes + colours * _COLOUR_ENTRY_BYTES
        lines = np.frombuffer(self._memory, np.uint8, bytes_per_line * height, start).reshape(height, bytes_per_line)
        self._pixels: NDArray[np.uint32] = lines[:, : 4 * width].view(np.uint32)

    def pixels(self) -> NDArray[np.uint32]:
        """A copy of what the screen shows now, (H, W), blue in the lowest byte."""
        return self._pixels.copy()


def green(pixels: NDArray[np.uint32]) -> Image:
    """The green channel, (H, W) 8-bit; patterns are grey, so all channels are equal."""
    return ((pixels >> 8) & 0xFF).astype(np.uint8)


class ScreenLight(Protocol):
    """The light of one screen or several, as `ScreenHistory` tells it."""

    def look(self) -> None:
        """Poll."""

    def decided_s(self, end_s: float) -> float:
        """When a poll determines all light until `end_s`."""

    def shares(self, begin_s: float, end_s: float) -> list[tuple[float, Light]]:
        """The light of each picture on the wall between two times, with its share."""


class SeveralScreens:
    """The light of several screens, each of which has its own share of one: the room's light is the sum."""

    def __init__(self, screens: Sequence[ScreenLight]) -> None:
        self._screens = screens

    def look(self) -> None:
        """Poll all screens."""
        for screen in self._screens:
            screen.look()

    def decided_s(self, end_s: float) -> float:
        """When a poll determines all light until `end_s`."""
        return max(screen.decided_s(end_s) for screen in self._screens)

    def shares(self, begin_s: float, end_s: float) -> list[tuple[float, Light]]:
        """The light of each screen's pictures on the wall between two times, with its share."""
        return [share for screen in self._screens for share in screen.shares(begin_s, end_s)]


class Pixels(Protocol):
    """A screen whose pixels can be read."""

    def pixels(self) -> NDArray[np.uint32]:
        """A copy of what it shows now."""


class ScreenHistory:
    """The light of the pictures of the last seconds. The screen is polled every 2 ms while the `with` block runs.

    Any number of pictures may be on their way to the wall, each with its own delay, in order
    (`hw/loopback/screen.py`). A change is dated to the last poll that did not show it yet, however late the next poll
    is; it never falls into an exposure that ended before the change. `develop` renders an image to light as soon as
    it appears. The last `album` renderings are cached.
    """

    def __init__(self, screen: Pixels, develop: Callable[[Image], Light], seed: int = 0, album: int = 4) -> None:
        self._screen = screen
        self._develop = develop
        self._studio = ThreadPoolExecutor(max_workers=1)
        self._album = album
        self._developed: dict[bytes, Future[Light]] = {}
        self._last = screen.pixels()
        self._looked_s = time.monotonic()
        self.wall = Wall(self._light(), seed)
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self._studio.shutdown()

    def look(self) -> None:
        """Poll the screen."""
        with self._lock:
            now_s = time.monotonic()
            pixels = self._screen.pixels()
            if not np.array_equal(pixels, self._last):
                self._last = self._settled(pixels)
                self.wall.send(self._looked_s, self._light())
            self._looked_s = now_s

    def decided_s(self, end_s: float) -> float:
        """When a poll determines all light until `end_s`: later pictures reach the wall a latency later."""
        return end_s - self.wall.conditions.latency_ms / 1e3

    def shares(self, begin_s: float, end_s: float) -> list[tuple[float, Light]]:
        """The light of each picture on the wall between two times, with its share; shares sum to one."""
        with self._lock:
            shares = self.wall.shares(begin_s, end_s)
        return [(share, light.result()) for share, light in shares]

    def _light(self) -> Future[Light]:
        """The light of the current picture; repeated pictures, as in a rehearsal, are rendered once."""
        key = blake2b(self._last.tobytes()).digest()
        light = self._developed.pop(key, None) or self._studio.submit(self._develop, green(self._last))
        self._developed[key] = light
        while len(self._developed) > self._album:
            del self._developed[next(iter(self._developed))]
        return light

    def _settled(self, pixels: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Wait until the screen is redrawn completely: a real projector swaps whole pictures."""
        while True:
            time.sleep(_REDRAWN_S)
            again = self._screen.pixels()
            if np.array_equal(again, pixels):
                return again
            pixels = again

    def _watch(self) -> None:
        while not self._ending.is_set():
            time.sleep(_POLL_S)
            self.look()
