"""The light path from a screen to the wall: latency with jitter for each picture, and panels that settle slowly."""

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from hw.loopback.settings import Conditions
from hw.simulated import Light

_MEMORY_S = 3.0
_REFRESH_S = 1 / 60


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
