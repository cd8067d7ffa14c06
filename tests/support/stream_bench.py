"""A projector and a streaming camera on a simulated clock."""

from collections.abc import Callable
from math import inf
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.numerics import Image
from hw.rig import Capabilities, Frame
from hw.timing import Arrival, FrameReader, Swap

SIZE = (64, 48)


class StreamBench:
    """Both devices. A frame arrives `delay_s` after its end, or up to `jitter_s` later. Rows are exposed one after the
    other within `readout_s`, for `exposure_s`. The camera's pixels are the projector's, one in five of which is unlit.
    """

    name = "bench"
    highest_level = 255
    size = SIZE
    capabilities = Capabilities(streaming=True)
    exposure_us = None
    dropped = 0

    def __init__(
        self,
        latency_s: float = 0.05,
        *,
        delay_s: float = 0.1,
        jitter_s: float = 0.0,
        readout_s: float = 0.012,
        exposure_s: float = 0.02,
        period_s: float = 1 / 30,
        noise: float = 1.0,
        dropping: float = 0.0,
        repeating: float = 0.0,
        average: int = 2,
    ) -> None:
        self.now = 0.0
        self.average = average
        self.period_s = period_s
        self.repeated = 0
        self._latency_s, self._delay_s, self._jitter_s = latency_s, delay_s, jitter_s
        self._readout_s, self._exposure_s, self._noise = readout_s, exposure_s, noise
        self._dropping, self._repeating = dropping, repeating
        self._rng = np.random.default_rng(0)
        self._prepared = np.zeros(SIZE[::-1], np.uint8)
        self._wall: list[tuple[float, Image]] = [(-1.0, self._prepared)]
        self._late_s: dict[int, float] = {}
        self._begin_s, self._arrival_s = 0.0, 0.0
        self._arrivals: list[Arrival] = []
        self.changed: Callable[[float, Image], Image] = lambda _, image: image

    @property
    def reader(self) -> FrameReader:
        return cast(FrameReader, self)

    def install(self, monkeypatch: pytest.MonkeyPatch) -> "StreamBench":
        clock = SimpleNamespace(monotonic=lambda: self.now)
        for module in ("hw.timing.stable_frames", "hw.timing.stream_calibration", "hw.timing.timed_rig"):
            monkeypatch.setattr(f"{module}.time", clock)
        return self

    def prepare(self, image: Image) -> None:
        self.now += 0.001
        self._prepared = image

    def flip(self) -> Swap:
        begun_s = self.now
        self.now += 0.002
        light_s = self.now + self._latency_s + self._late_s.pop(len(self._wall), 0.0)
        self._wall.append((max(light_s, self._wall[-1][0]), self._prepared))
        return Swap(begun_s, self.now)

    def delay(self, number: int, seconds: float) -> None:
        """Shift the light of the picture with this number by this time."""
        self._late_s[len(self._wall) + number] = seconds

    def grab(self) -> Frame:
        return Frame(self.following(self.newest).image)

    def show(self, image: Image) -> None:
        self.prepare(image)
        self.flip()

    @property
    def newest(self) -> int:
        while self._next_comes_s() <= self.now:
            self._take()
        return len(self._arrivals) - 1

    def following(self, number: int) -> Arrival:
        found = self.following_until(number, inf)
        assert found is not None
        return found

    def following_until(self, number: int, until_s: float) -> Arrival | None:
        found = None
        while found is None:
            while len(self._arrivals) <= number + 1:
                if max(self._arrival_s, self._next_comes_s()) > until_s:
                    self.now = max(self.now, until_s)
                    return None
                self._take()
            number += 1
            found = None if self._arrivals[number].repeated else self._arrivals[number]
        self.now = max(self.now, found.came_s)
        return found

    def _next_comes_s(self) -> float:
        return self._begin_s + self._readout_s + self._exposure_s + self._delay_s

    def _take(self) -> None:
        came_s = max(self._arrival_s, self._next_comes_s() + self._jitter_s * self._rng.random())
        if self._rng.random() >= self._dropping:
            self._arrival_s = came_s
            image = self.changed(self._begin_s, self._seen())
            self._arrivals.append(Arrival(image, len(self._arrivals), came_s, None, False))
            if self._rng.random() < self._repeating:
                self.repeated += 1
                self._arrivals.append(Arrival(image, len(self._arrivals), came_s + 0.001, None, True))
        self._begin_s += self.period_s

    def _seen(self) -> Image:
        end_s = self._begin_s + self._readout_s + self._exposure_s
        if any(self._begin_s < moment < end_s for moment, _ in self._wall[-3:]):
            light = np.stack([self._row(row) for row in range(SIZE[1])])
        else:
            shown = next(image for moment, image in reversed(self._wall) if moment <= self._begin_s)
            light = seen_row(shown.astype(float))
        image = light + self._noise * self._rng.standard_normal(SIZE[::-1])
        return np.rint(image).clip(0, 255).astype(np.uint8)

    def _row(self, row: int) -> np.ndarray:
        begin_s = self._begin_s + self._readout_s * row / SIZE[1]
        end_s = begin_s + self._exposure_s
        until = [*(moment for moment, _ in self._wall[1:]), np.inf]
        total = np.zeros(SIZE[0])
        for (moment, image), next_s in zip(self._wall, until, strict=True):
            total += max(0.0, min(next_s, end_s) - max(moment, begin_s)) / self._exposure_s * image[row]
        return seen_row(total)


def seen_row(light: np.ndarray) -> np.ndarray:
    """Levels of light 0 … 255, (…, W)."""
    lit = np.arange(SIZE[0]) % 5 != 4
    return np.asarray(20.0 + 0.6 * light * lit)
