"""Several cameras before the wall of a bench."""

from typing import Any

from tests.support.rig_bench import Bench


class BesideBench(Bench):
    """A camera that sees the wall of a bench, by the same clock.

    `held_up`: of its exposures from now on, those with these numbers begin `held_up_s` late, which nobody tells.
    """

    def __init__(self, bench: Bench, name: str, **how: Any) -> None:
        self._bench = bench
        super().__init__(**how)
        self.name = name
        self._wall = bench._wall
        self.held_up: range | frozenset[int] = frozenset()
        self.held_up_s = 0.0

    @property
    def now(self) -> float:
        return self._bench.now

    @now.setter
    def now(self, now: float) -> None:
        if hasattr(self, "_wall"):  # there already when it looks on
            self._bench.now = now

    def _until_transferred_s(self) -> float:
        """All cameras transfer their frames at the same time."""
        return max(0.0, self._begin + self.exposure_s + self._transfer_s - self.now)

    def expose(self, *meanwhile: Any) -> float:
        triggered = super().expose(*meanwhile)
        if self.exposures - 1 in self.held_up:
            self._begin += self.held_up_s
        return triggered
