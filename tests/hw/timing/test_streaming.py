"""Frames of a streaming camera, on a simulated clock."""

from collections.abc import Callable, Iterator
from math import inf
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Capabilities, Frame, Redundancy
from hw.timing import Arrival, FrameReader, Swap
from hw.timing.streaming import StreamedRig, streamed
from scanner.capture import findings_on_camera
from scanner.patterns import Black, Gray, Pattern, Phase, White, draw, level_groups, unpaired_bits

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


INVERSES: tuple[Pattern, ...] = (
    White(),
    Black(),
    *(Gray("x", bit, 6, inverted=inverted) for bit in range(4) for inverted in (False, True)),
    *(Phase("x", 16.0, step / 4) for step in range(4)),
)
BITS: tuple[Pattern, ...] = (White(), Black(), *(Gray(axis, bit, 6) for axis in ("x", "y") for bit in range(4)))


def photographed(rig: StreamedRig, patterns: tuple[Pattern, ...]) -> Iterator[tuple[Image, np.ndarray]]:
    """Frames, and the expected ones."""
    pictures = [draw(pattern, SIZE) for pattern in patterns]
    frames = rig.photograph(pictures, (), Redundancy(level_groups(patterns), unpaired_bits(patterns)))
    for picture, frame in zip(pictures, frames, strict=True):
        yield frame.image, seen_row(picture.astype(float))


def worst_deviation(rig: StreamedRig, patterns: tuple[Pattern, ...]) -> float:
    """Rms deviation of the worst frame from its expectation, in grey levels."""
    return max(float(np.sqrt(np.mean((image - own) ** 2))) for image, own in photographed(rig, patterns))


@pytest.mark.parametrize("patterns", [INVERSES, BITS], ids=["inverses", "bits without inverses"])
@pytest.mark.parametrize(
    "conditions",
    [
        {},
        {"latency_s": 0.005, "delay_s": 0.0},
        {"latency_s": 0.12, "delay_s": 0.5, "jitter_s": 0.05},
        {"readout_s": 0.033, "exposure_s": 0.033, "jitter_s": 0.01},
        {"dropping": 0.2, "repeating": 0.2},
    ],
    ids=["usual", "at once", "late", "rolling", "lossy"],
)
def test_each_frame_shows_its_own_picture_only(
    monkeypatch: pytest.MonkeyPatch, conditions: dict[str, Any], patterns: tuple[Pattern, ...]
) -> None:
    bench = StreamBench(**conditions).install(monkeypatch)
    rig = streamed(bench, bench, {})
    assert 0.3 < worst_deviation(rig, patterns) < 1.0  # of two frames with noise of one grey level: 0.77
    delay_s = conditions.get("latency_s", 0.05) + conditions.get("delay_s", 0.1)
    assert delay_s < rig.latency_s < delay_s + 0.05 + conditions.get("jitter_s", 0.0)
    if not conditions:
        assert rig.acquisition.doubted == 0
        in_flight_s = rig.tally.elapsed_s - rig.latency_s  # the first is waited for
        per_picture_s = in_flight_s / (len(patterns) + len(unpaired_bits(patterns)))
        assert 2.5 * bench.period_s < per_picture_s < 4.5 * bench.period_s  # one or two of which are of both pictures
        assert rig.acquisition.stable_frames.missed <= 1


def test_averaging_frames_reduces_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = []
    for average in (2, 8):
        bench = StreamBench(noise=3.0, average=average).install(monkeypatch)
        noise.append(worst_deviation(streamed(bench, bench, {}), INVERSES))
    assert 1.6 < noise[0] / noise[1] < 2.2


@pytest.mark.parametrize("patterns", [INVERSES, BITS], ids=["inverses", "bits without inverses"])
@pytest.mark.parametrize("delay_s", [0.4, 1.5])
def test_a_late_picture_is_waited_for_or_detected(
    monkeypatch: pytest.MonkeyPatch, patterns: tuple[Pattern, ...], delay_s: float
) -> None:
    bench = StreamBench().install(monkeypatch)
    rig = streamed(bench, bench, {})
    bench.delay(
        1 + len(patterns) // 2, 0.8
    )  # behind the reference picture; the frames before it stand, and are others'
    assert worst_deviation(rig, patterns) < 1.0
    assert 1 <= rig.acquisition.doubted + rig.acquisition.stable_frames.missed <= 8


def blurred(image: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5))


@pytest.mark.parametrize(
    ("key", "change", "least"),
    [
        ("exposure", lambda image: image * 1.1, 8),
        ("white_balance", lambda image: image * (1.06, 1.0, 0.95), 8),
        ("focus", blurred, 20),
    ],
)
def test_a_setting_that_the_camera_changes_is_named(
    monkeypatch: pytest.MonkeyPatch, key: str, change: Callable[[np.ndarray], np.ndarray], least: float
) -> None:
    bench = StreamBench().install(monkeypatch)
    bad_s = np.inf

    def coloured(now: float, image: Image) -> Image:
        seen = image[:, :, None].astype(float) * (1.0, 1.0, 1.0)
        return np.rint(change(seen) if now > bad_s else seen).astype(np.uint8)

    bench.changed = coloured
    rig = streamed(bench, bench, {})
    assert len([*photographed(rig, INVERSES)]) == len(INVERSES)
    assert [*findings_on_camera(rig.account())] == []
    bad_s = bench.now + 2
    assert len([*photographed(rig, INVERSES)]) == len(INVERSES)
    percent = cast(dict[str, float], rig.account()["camera_changed"])
    assert least < abs(percent[f"{key}_percent"]) < 3 * least
    (finding,) = findings_on_camera(rig.account())
    assert key.replace("_", " ") in finding.message
    assert finding.data == {f"{key}_percent": abs(percent[f"{key}_percent"])}


@pytest.mark.parametrize("most_gain", [1.1, 2.0])
def test_automatic_exposure_is_named_or_refused(monkeypatch: pytest.MonkeyPatch, most_gain: float) -> None:
    """By the share of a brightness change that it compensates."""
    bench = StreamBench().install(monkeypatch)
    gain = [1.0]

    def adapted(_: float, image: Image) -> Image:
        seen = gain[0] * image
        gain[0] = float(np.clip(gain[0] * (60 / max(1.0, float(seen.mean()))) ** 0.02, 1.0, most_gain))
        return np.rint(seen).clip(0, 255).astype(np.uint8)

    bench.changed = adapted
    if most_gain == 2.0:
        with pytest.raises(DeviceError, match=r"its automatic exposure is on: .* change by \d+ %"):
            streamed(bench, bench, {})
        return
    rig = streamed(bench, bench, {})
    assert len([*photographed(rig, INVERSES)]) == len(INVERSES)
    assert any("after_white_percent" in finding.data for finding in findings_on_camera(rig.account()))


def test_a_picture_that_never_settles_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = StreamBench().install(monkeypatch)
    rig = streamed(bench, bench, {})
    bench.changed = lambda now, image: (image * (1.0 if int(30 * now) % 2 else 0.9)).astype(np.uint8)
    with pytest.raises(DeviceError, match=r"camera bench: 5 s after .* automatic exposure"):
        [*photographed(rig, INVERSES)]


@pytest.mark.parametrize("amid", [False, True])
def test_a_frozen_picture_is_named(monkeypatch: pytest.MonkeyPatch, amid: bool) -> None:
    bench = StreamBench().install(monkeypatch)
    still = np.full(SIZE[::-1], 90, np.uint8)
    if amid:
        rig = streamed(bench, bench, {})
    bench.changed = lambda _, image: still
    with pytest.raises(DeviceError, match="frozen"):
        [*photographed(rig if amid else streamed(bench, bench, {}), INVERSES)]


def test_a_camera_turned_during_a_capture_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = StreamBench().install(monkeypatch)
    rig = streamed(bench, bench, {})
    begun_s = bench.now
    bench.changed = lambda now, image: image if now < begun_s + 1.2 else np.fliplr(image).copy()
    with pytest.raises(DeviceError, match="camera bench: it sees another picture than when the capture began"):
        [*photographed(rig, INVERSES)]
