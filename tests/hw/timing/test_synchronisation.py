"""Sequential acquisition, on a simulated clock."""

from typing import cast

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.timing.devices import CameraGroup
from hw.timing.sequential import SequentialAcquisition, Timing
from hw.timing.synchronisation import synchronised
from tests.support.rig_bench import SIZE, Bench


def pictures(count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(1).integers(0, 256, (count, *SIZE[::-1])).astype(np.uint8))


def expected(picture: np.ndarray) -> np.ndarray:
    """What the bench's camera sees of a settled picture."""
    return 10 + 12 * np.where(np.arange(SIZE[0]) % 5 != 4, picture.astype(int), 0)


@pytest.mark.parametrize("latency_ms", [0, 3, 17, 33.3, 50, 75, 120, 250])
def test_the_latency_is_measured(monkeypatch: pytest.MonkeyPatch, latency_ms: float) -> None:
    bench = Bench(latency_ms / 1e3, noise=2.0).install(monkeypatch)
    timing = synchronised(bench, bench, {}).timing
    assert 1e3 * timing.latency_s == pytest.approx(latency_ms, abs=0.5)
    assert 0 < timing.delay_s - timing.latency_s < 0.006
    assert timing.overlaps == (latency_ms > 10)


def test_the_latency_is_that_of_the_slowest_flash(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.05, jitter_s=0.01).install(monkeypatch)
    timing = synchronised(bench, bench, {}).timing
    assert 0.055 < timing.latency_s <= 0.0605


@pytest.mark.parametrize("latency_ms", [0, 17, 50, 120])
@pytest.mark.parametrize("lost", [frozenset[int](), frozenset({19, 25, 26, 31}), frozenset(range(20, 200, 3))])
def test_each_frame_shows_its_own_picture(
    monkeypatch: pytest.MonkeyPatch, latency_ms: float, lost: frozenset[int]
) -> None:
    bench = Bench(latency_ms / 1e3, lost=lost).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    shown = pictures(24)
    frames = list(rig.photograph(shown))
    assert len(frames) == len(shown)
    for picture, frame in zip(shown, frames, strict=True):
        np.testing.assert_allclose(frame.image, expected(picture), atol=1)


def test_retriggered_frames_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    rig = synchronised(bench, bench, {})
    bench._lost = frozenset({bench.exposures + 2, bench.exposures + 5, bench.exposures + 6})
    list(rig.photograph(pictures(10)))
    account = cast(dict[str, object], rig.account()["synchronisation"])
    assert account["retriggered_frames"] == 3
    assert account["overlapping"] is True


def test_the_next_picture_goes_up_while_the_last_frame_is_transferred(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    sequential = SequentialAcquisition(bench, CameraGroup([bench]), Timing(0.05, 0.054, overlaps=True))
    list(sequential.frames(pictures(3)))
    assert bench.log == [
        *("prepare", "flip", "prepare", "expose", "flip", "collect"),
        *("prepare", "expose", "flip", "collect", "expose", "collect"),
    ]


def test_without_overlap_a_picture_waits_for_the_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    list(SequentialAcquisition(bench, CameraGroup([bench]), Timing(0.0, 0.004, overlaps=False)).frames(pictures(2)))
    assert bench.log == ["prepare", "flip", "prepare", "expose", "collect", "flip", "expose", "collect"]


def test_a_frame_is_taken_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    frames = SequentialAcquisition(bench, CameraGroup([bench]), Timing(0.05, 0.054, overlaps=True)).frames(pictures(3))
    assert bench.exposures == 0
    next(frames)
    assert bench.exposures == 1


def test_the_overhead_excludes_exposure_and_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.05, transfer_s=0.0).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    list(rig.photograph(pictures(50)))
    # 4 ms of margin, 2 for the flip, beside 83 of exposure and latency.
    assert rig.overhead == pytest.approx(6 / 83.3, abs=0.005)
    slow = Bench(0.05, transfer_s=0.1).install(monkeypatch)
    rig = synchronised(slow, slow, {})
    list(rig.photograph(pictures(50)))
    assert rig.overhead == pytest.approx((33.3 + 2 + 100 + 1) / 83.3 - 1, abs=0.02)


def test_with_a_rolling_shutter_pictures_do_not_overlap(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.02, readout_s=0.06, transfer_s=0.08).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    assert not rig.timing.overlaps
    shown = pictures(6)
    for picture, frame in zip(shown, rig.photograph(shown), strict=True):
        np.testing.assert_allclose(frame.image, expected(picture), atol=1)


def test_without_pictures_no_frames_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    assert list(SequentialAcquisition(bench, CameraGroup([bench]), Timing(0.05, 0.054, overlaps=True)).frames([])) == []


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        (Bench(gain=0.0), "no difference between a white and a black picture"),
        (Bench(gain=0.001, noise=5.0), "no difference"),
        (Bench(gain=10.0), "overexposed"),
        (Bench(latency_s=9.0), "no difference"),
        (Bench(lost=frozenset(range(1000))), "do not arrive"),
    ],
    ids=["cap", "dim", "bright", "elsewhere", "unplugged"],
)
def test_a_rig_that_cannot_work_is_refused(monkeypatch: pytest.MonkeyPatch, bench: Bench, words: str) -> None:
    bench.install(monkeypatch)
    with pytest.raises(DeviceError, match=words):
        synchronised(bench, bench, {})


def test_a_frame_lost_repeatedly_ends_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    rig = synchronised(bench, bench, {})
    frames = rig.photograph(pictures(5))
    next(frames)
    next(frames)
    bench._lost = frozenset(range(10_000))
    with pytest.raises(DeviceError, match=r"camera bench: frame 2 was lost 8 times \(incomplete: missing-packets\)"):
        next(frames)
