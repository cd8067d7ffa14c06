"""A projector and a camera on a simulated clock, without waiting; and a small rig whose light and lenses change."""

from collections.abc import Callable
from math import ceil
from types import SimpleNamespace

import numpy as np
import pytest

from calib.numerics import Image
from hw.errors import FrameLostError
from hw.rig import Capabilities, Frame, Rig
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from hw.timing import Swap, nothing
from scanner.checking import CheckReport, CheckRow
from scanner.configuration import Config, load_config

SIZE = (8, 6)


class Bench:
    """Both devices. The wall shows a picture `latency_s` after its flip; the camera sees the wall pixel by pixel."""

    name = "bench"
    capabilities = Capabilities(clock=True)
    highest_level = 4095
    wait_s = 0.0
    late_s = 0.0

    def __init__(
        self,
        latency_s: float = 0.05,
        *,
        exposure_s: float = 1 / 30,
        transfer_s: float = 0.02,
        readout_s: float = 0.0,
        jitter_s: float = 0.0,
        noise: float = 0.0,
        lost: frozenset[int] = frozenset(),
        gain: float = 1.0,
        lag_s: float = 0.0,
        seed: int = 0,
        size: tuple[int, int] = SIZE,
        sending_s: float = 0.0,
    ) -> None:
        self.now = 0.0
        self.size = size
        self.exposure_s = exposure_s
        self._latency_s, self._transfer_s, self._readout_s, self._jitter_s = latency_s, transfer_s, readout_s, jitter_s
        self._noise, self._gain = noise, gain
        self._lost = lost
        self._lag_s = lag_s
        self._sending_s = sending_s
        self._late = range(0)
        self._late_s: dict[int, float] = {}
        self._late_share = self._busy_share = 0.0
        self._rng = np.random.default_rng(seed)
        self._prepared = np.zeros(size[::-1], np.uint8)
        self._wall: list[tuple[float, Image]] = [(-1.0, self._prepared)]
        self._begin = 0.0
        self._swaps: list[Swap] = []
        self.exposures = 0
        self.log: list[str] = []

    def install(self, monkeypatch: pytest.MonkeyPatch) -> "Bench":
        clock = SimpleNamespace(monotonic=lambda: self.now, sleep=self._sleep)
        for module in (
            "hw.timing.latency",
            "hw.timing.sequential",
            "hw.timing.timed_rig",
            "hw.timing.pipelined",
            "hw.timing.trigger_schedule",
        ):
            monkeypatch.setattr(f"{module}.time", clock)
        return self

    def prepare(self, image: Image) -> None:
        self._sleep(0.001)
        self._prepared = image
        self.log.append("prepare")

    def flip(self) -> Swap:
        begun = self.now
        self._sleep(0.002)
        self._leave(self._prepared, self.now)
        self.log.append("flip")
        return Swap(begun, self.now)

    def show_at(self, image: Image, when_s: float) -> None:
        """A late call is executed, too: its picture is on the wall when its time has come."""
        self._sleep(self._sending_s)
        begun = max(when_s + self._held_up_s(), self.now, self._swaps[-1].done_s if self._swaps else 0.0)
        self._swaps.append(Swap(begun, begun + 0.002))
        self._leave(image, begun + 0.002)

    def shown(self, *, wait: bool) -> Swap | None:
        if not wait and self._swaps[0].done_s > self.now:
            return None
        swap = self._swaps.pop(0)
        self.now = max(self.now, swap.done_s)
        return swap

    def delay_every(self, count: int) -> None:
        """From now on, one of this many pictures is late by a refresh, unreported."""
        self._late = range(len(self._wall) + 4, 10**9, count)

    def delay_some(self, share: float, busy_share: float) -> None:
        """From now on, this share of pictures is late by a refresh, unreported; and this share of swaps and triggers is
        delayed by a few milliseconds, which is reported.
        """
        self._late_share, self._busy_share = share, busy_share

    def delay(self, number: int, seconds: float) -> None:
        """Shift the light of the picture with this number in time."""
        self._late_s[len(self._wall) + number] = seconds

    def _leave(self, image: Image, moment: float) -> None:
        light = moment + self._latency_s + self._jitter_s * self._rng.random()
        light += self._late_s.get(len(self._wall), 0.0)
        light += 1 / 60 if len(self._wall) in self._late or self._by_chance(self._late_share) else 0.0
        self._wall.append((max(light, self._wall[-1][0]), image))

    def show(self, image: Image) -> None:
        self.prepare(image)
        self.flip()

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        self._sleep(self._held_up_s())
        triggered = self.now
        meanwhile()
        self.late_s = self._lag_s * self._rng.random()
        self._begin = triggered + self.late_s
        if self.wait_s:  # it runs freely
            self._begin = triggered = self.wait_s * ceil(self._begin / self.wait_s)
        self._sleep(max(0.0, self._begin - self.now + self.exposure_s))
        self.exposures += 1
        self.log.append("expose")
        return triggered

    def collect(self) -> Frame:
        self._sleep(self._until_transferred_s())
        self.log.append("collect")
        if self.exposures - 1 in self._lost:
            raise FrameLostError("incomplete: missing-packets")
        rows = [self._seen(row) for row in range(self.size[1])]
        image = self._gain * np.stack(rows) + self._noise * self._rng.standard_normal(self.size[::-1])
        return Frame(np.rint(image).clip(0, 4095).astype(np.uint16))

    def _until_transferred_s(self) -> float:
        return self._transfer_s + self.late_s

    def grab(self) -> Frame:
        self.expose()
        return self.collect()

    def _seen(self, row: int) -> np.ndarray:
        """A row of the wall, averaged over its exposure; levels 10 to 3070, and one pixel in five unlit."""
        begin = self._begin + self._readout_s * row / self.size[1]
        end = begin + self.exposure_s
        since = [moment for moment, _ in self._wall]
        total = np.zeros(self.size[0])
        for (moment, image), until in zip(self._wall, [*since[1:], np.inf], strict=True):
            total += max(0.0, min(until, end) - max(moment, begin)) / self.exposure_s * image[row]
        lit = np.arange(self.size[0]) % 5 != 4
        return 10.0 + 12.0 * total * lit

    def _by_chance(self, share: float) -> bool:
        return bool(share and self._rng.random() < share)

    def _held_up_s(self) -> float:
        return float(self._rng.exponential(0.004)) if self._by_chance(self._busy_share) else 0.0

    def _sleep(self, seconds: float) -> None:
        assert seconds >= 0
        self.now += seconds


CAMERA, PROJECTOR = (306, 256), (214, 120)
PERIOD_US = 1e6 / 60
OVERRIDES = (
    "rig={backend: simulated, seed: 0}",
    f"camera={{width: {CAMERA[0]}, height: {CAMERA[1]}, principal_point: {{known: [157.04, 131.79]}}}}",
    f"projector={{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}",
    "corner.squareness_deg=0",
)


def config(*overrides: str) -> Config:
    return load_config(None, (*OVERRIDES, *overrides))


def changed(room: SimulatedRoom, **settings: object) -> SimulatedRoom:
    """The same room with other settings of its light, lenses and sensor."""
    return room.under(**settings)


def rig_in(room: SimulatedRoom) -> Rig:
    projector = SimulatedProjector(room)
    return Rig(projector, SimulatedCamera(room, projector), {"backend": "simulated"}, room.settings.refresh_hz)


def row(report: CheckReport, name: str) -> CheckRow:
    (found,) = [row for row in report.rows if row.name == name]
    return found
