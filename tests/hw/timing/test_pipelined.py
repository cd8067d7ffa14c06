"""Pipelined acquisition, on a simulated clock."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.rig import Redundancy
from hw.timing.devices import nothing
from hw.timing.synchronisation import SynchronisedRig, synchronised
from scanner.patterns import draw, level_groups, sequence_for, unpaired_bits
from tests.support.rig_bench import SIZE, Bench

COUNT = 40


def pictures(count: int = COUNT) -> list[np.ndarray]:
    """Pictures, each followed by its inverse."""
    drawn = np.random.default_rng(1).choice(np.array([0, 255], np.uint8), (count // 2, *SIZE[::-1]))
    return [each for picture in drawn for each in (picture, 255 - picture)]


def pairs(count: int = COUNT) -> list[tuple[int, int]]:
    return [(first, first + 1) for first in range(0, count, 2)]


def expected(picture: np.ndarray) -> np.ndarray:
    """What the bench's camera sees of a settled picture."""
    return 10 + 12 * np.where(np.arange(picture.shape[1]) % 5 != 4, picture.astype(int), 0)


_WHITE = 3060  # levels from black to white
_UNTOLD = 0.02  # of a frame: what sums of so few pixels do not tell from noise


def scanned(
    monkeypatch: pytest.MonkeyPatch, bench: Bench, late_every: int = 0, foreign: float = 0.0023
) -> SynchronisedRig:
    """A rig after a capture; each frame shows its own picture, with at most this share of `foreign` light."""
    bench.install(monkeypatch)
    rig = synchronised(bench, bench, {})
    if late_every:
        bench.delay_every(late_every)
    shown = pictures()
    frames = list(rig.photograph(shown, redundancy=Redundancy(pairs())))
    assert len(frames) == len(shown)
    for number, (picture, frame) in enumerate(zip(shown, frames, strict=True)):
        np.testing.assert_allclose(frame.image, expected(picture), atol=foreign * _WHITE, err_msg=f"frame {number}")
    return rig


@pytest.mark.parametrize("latency_ms", [0, 5, 20, 50, 120, 250])
def test_a_frame_takes_its_exposure_and_a_margin_whatever_the_latency(
    monkeypatch: pytest.MonkeyPatch, latency_ms: float
) -> None:
    bench = Bench(latency_ms / 1e3, transfer_s=0.005, jitter_s=0.001, lag_s=0.001)
    rig = scanned(monkeypatch, bench)
    assert rig.pipelined is not None
    assert (rig.pipelined.missed, rig.pipelined.doubted) == (0, 0)
    beside = latency_ms / 1e3 / COUNT  # the first picture's light is waited for
    assert 1.1 < (rig.sequential.tally.seconds_per_frame - beside) / bench.exposure_s < 1.23
    assert rig.pipelined.rhythm.outstanding == pytest.approx(latency_ms / 40, abs=1.1)


def test_pictures_are_sent_during_exposures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sending takes no additional time."""
    rig = scanned(monkeypatch, Bench(0.05, transfer_s=0.002, sending_s=0.008))
    assert rig.pipelined is not None
    assert rig.pipelined.missed == 0
    assert 1.1 < (rig.sequential.tally.seconds_per_frame - 0.05 / COUNT) / (1 / 30) < 1.23


def test_a_slow_transfer_sets_the_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = scanned(monkeypatch, Bench(0.12, transfer_s=0.045))
    assert rig.pipelined is not None
    assert rig.pipelined.missed <= 1
    assert rig.sequential.tally.seconds_per_frame == pytest.approx(1 / 30 + 0.045, rel=0.1)


@pytest.mark.parametrize("lost", [frozenset({40, 41, 60}), frozenset(range(40, 200, 3))])
@pytest.mark.parametrize("latency_ms", [0, 50, 120])
def test_lost_frames_are_taken_again(monkeypatch: pytest.MonkeyPatch, latency_ms: float, lost: frozenset[int]) -> None:
    rig = scanned(monkeypatch, Bench(latency_ms / 1e3, transfer_s=0.005, lost=lost))
    assert rig.sequential.tally.retriggered >= 2


@pytest.mark.parametrize("latency_ms", [5, 50, 120])
def test_unreported_late_pictures_are_detected(monkeypatch: pytest.MonkeyPatch, latency_ms: float) -> None:
    rig = scanned(monkeypatch, Bench(latency_ms / 1e3, transfer_s=0.005), late_every=9)
    assert rig.pipelined is not None
    assert 4 <= rig.pipelined.doubted <= 20


@pytest.mark.parametrize("seed", [1, 14])
def test_a_picture_that_is_late_twice_is_detected(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """The same picture is late in both takes of its group, and equal frames must not be attributed to the scene."""
    bench = Bench(0.12, transfer_s=0.005, jitter_s=0.008, lag_s=0.001, seed=seed)
    rig = scanned(monkeypatch, bench, late_every=9, foreign=_UNTOLD)
    assert rig.sequential.tally.retriggered > 6


@pytest.mark.parametrize("latency_ms", [20, 50, 120])
def test_a_lost_frame_costs_the_time_of_one(monkeypatch: pytest.MonkeyPatch, latency_ms: float) -> None:
    """Its picture is shown again after those in the pipeline, and the others do not wait."""
    lost: dict[bool, float] = {}
    for loses in (False, True):
        bench = Bench(latency_ms / 1e3, transfer_s=0.005, jitter_s=0.001).install(monkeypatch)
        rig = synchronised(bench, bench, {})
        bench._lost = frozenset({bench.exposures + 9} if loses else ())
        shown = pictures()
        for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(pairs())), strict=True):
            np.testing.assert_allclose(frame.image, expected(picture), atol=7)
        lost[loses] = rig.sequential.tally.elapsed_s / bench.exposure_s
        assert rig.sequential.tally.retriggered == loses
    assert 1 < lost[True] - lost[False] < 2  # the slack that it asks for fades


@pytest.mark.parametrize("latency_ms", [20, 120])
def test_a_single_late_picture_does_not_stop_the_pipeline(monkeypatch: pytest.MonkeyPatch, latency_ms: float) -> None:
    """Its group is repeated in the pipeline: two more frames, at any latency."""
    elapsed = []
    for late in (False, True):
        bench = Bench(latency_ms / 1e3, transfer_s=0.005, jitter_s=0.001).install(monkeypatch)
        rig = synchronised(bench, bench, {})
        if late:
            bench.delay_every(10**6)
        shown = pictures()
        for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(pairs())), strict=True):
            np.testing.assert_allclose(frame.image, expected(picture), atol=0.0023 * _WHITE)
        assert rig.pipelined is not None
        assert rig.pipelined.doubted == 2 * late
        elapsed.append(rig.sequential.tally.elapsed_s / bench.exposure_s)
    assert 2 < elapsed[1] - elapsed[0] < 4


def test_jitter_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture slightly later than any flash leaves no detectable share of the previous one."""
    rig = scanned(monkeypatch, Bench(0.05, transfer_s=0.005, jitter_s=0.015), foreign=_UNTOLD)
    assert 1.3 < rig.sequential.tally.seconds_per_frame * 30 < 3


def test_the_delay_of_exposures_is_learnt(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is learnt in the rehearsal; unexpected delays cause repetitions."""
    missed = []
    for surprising in (False, True):
        bench = Bench(0.05, transfer_s=0.005, lag_s=0.0 if surprising else 0.009).install(monkeypatch)
        rig = synchronised(bench, bench, {})
        bench._lag_s = 0.009
        shown = pictures()
        for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(pairs())), strict=True):
            np.testing.assert_allclose(frame.image, expected(picture), atol=0.0023 * _WHITE)
        assert rig.pipelined is not None
        missed.append(rig.pipelined.missed)
    assert missed[0] <= 1 < missed[1] < COUNT / 4


def test_a_rolling_shutter_is_read_out_before_the_next_light(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = scanned(monkeypatch, Bench(0.02, readout_s=0.06, transfer_s=0.08))
    assert 1 / 30 + 0.08 < rig.sequential.tally.seconds_per_frame < 1.1 * (1 / 30 + 0.08)
    rig = scanned(monkeypatch, Bench(0.05, readout_s=0.01, transfer_s=0.01))
    assert 1 / 30 + 0.01 < rig.sequential.tally.seconds_per_frame < 1.6 / 30


def test_noise_causes_no_repetition(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.05, transfer_s=0.005, noise=60.0).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    shown = pictures()
    for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(pairs())), strict=True):
        np.testing.assert_allclose(frame.image, expected(picture), atol=300)
    assert rig.pipelined is not None
    assert rig.pipelined.doubted <= 2


def test_unverifiable_pictures_are_taken_sequentially(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.05, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    shown = pictures(12)
    proven = [(0, 1), (8, 9)]
    for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(proven)), strict=True):
        np.testing.assert_allclose(frame.image, expected(picture), atol=2)
    begun = bench.log[-bench.log[::-1].index("prepare") :]
    assert begun  # the pictures in turns are flipped one by one
    assert rig.sequential.tally.seconds_per_frame > 0.06


QUICK_SIZE = (96, 64)
QUICK = sequence_for(QUICK_SIZE, cell=4, inverses=False, periods=(13.0,), shifts=4)


def scanned_without_inverses(
    monkeypatch: pytest.MonkeyPatch,
    bench: Bench,
    *,
    late_every: int = 0,
    late_share: float = 0.0,
    noise: float = 0.0,
) -> SynchronisedRig:
    """A rig after a capture of bits without inverses; each frame shows its own picture only."""
    bench.install(monkeypatch)
    rig = synchronised(bench, bench, {})
    if late_every:
        bench.delay_every(late_every)
    if late_share:
        bench.delay_some(late_share, busy_share=0.2)
    shown = [draw(pattern, QUICK_SIZE) for pattern in QUICK]
    frames = list(rig.photograph(shown, (), Redundancy(level_groups(QUICK), unpaired_bits(QUICK))))
    assert len(frames) == len(shown)
    for number, (picture, frame) in enumerate(zip(shown, frames, strict=True)):
        off = frame.image - expected(picture)
        assert np.abs(off).max() < _UNTOLD * _WHITE + 5 * noise, f"frame {number}"
    return rig


@pytest.mark.parametrize("latency_ms", [5, 50, 120])
def test_bits_without_inverses_are_pipelined(monkeypatch: pytest.MonkeyPatch, latency_ms: float) -> None:
    """This costs one parity picture for each axis."""
    bench = Bench(latency_ms / 1e3, transfer_s=0.005, jitter_s=0.001, noise=30.0, size=QUICK_SIZE)
    rig = scanned_without_inverses(monkeypatch, bench, noise=30.0)
    assert rig.pipelined is not None
    assert (rig.pipelined.missed, rig.pipelined.doubted) == (0, 0)
    count = len(QUICK)
    exposures = (rig.sequential.tally.elapsed_s - latency_ms / 1e3) / bench.exposure_s
    assert 1.1 * (count + 2) < exposures < 1.3 * (count + 2)


@pytest.mark.parametrize("exposure_s", [1 / 60, 1 / 30])
@pytest.mark.parametrize("late_every", [5, 8])
def test_unreported_late_bits_without_inverses_are_detected(
    monkeypatch: pytest.MonkeyPatch, exposure_s: float, late_every: int
) -> None:
    """Late by half an exposure, or by a whole one: then a frame shows only the previous picture."""
    bench = Bench(0.05, exposure_s=exposure_s, transfer_s=0.003, size=QUICK_SIZE)
    rig = scanned_without_inverses(monkeypatch, bench, late_every=late_every)
    assert rig.pipelined is not None
    assert 1 <= rig.pipelined.doubted <= 30


@pytest.mark.parametrize("seed", [219, 366, 460, 545])
def test_random_late_pictures_on_a_busy_computer_are_detected(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """After black and white, which have no edges; after others of their group; two equally late steps of a fringe."""
    bench = Bench(0.05, transfer_s=0.005, jitter_s=0.001, lag_s=0.001, noise=30.0, seed=seed, size=QUICK_SIZE)
    rig = scanned_without_inverses(monkeypatch, bench, late_share=0.08, noise=30.0)
    assert rig.sequential.tally.retriggered > 0


@pytest.mark.parametrize(("latency_ms", "most"), [(0, 3.3), (20, 3.3), (50, 2.5), (120, 2.5)])
def test_a_free_running_camera_has_one_frame_between_two_pictures(
    monkeypatch: pytest.MonkeyPatch, latency_ms: float, most: float
) -> None:
    """Light that arrives before the next frame begins is hard to schedule, so pictures are taken sequentially."""
    bench = Bench(latency_ms / 1e3, transfer_s=0.005)
    bench.wait_s = 1 / 29
    rig = scanned(monkeypatch, bench)
    beside = latency_ms / 1e3 / COUNT
    assert 1.9 < (rig.sequential.tally.seconds_per_frame - beside) / bench.exposure_s < most
    assert (rig.pipelined is not None) == (latency_ms >= 50)


class _UnknownBegin(Bench):
    """Exposes on a trigger; nobody knows when."""

    _asked = False

    @property
    def wait_s(self) -> float:  # type: ignore[override]
        return float("inf") if self._asked else 0.0

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        self._asked = False
        moment = super().expose(meanwhile)
        self._asked = True
        return moment


def test_a_camera_that_exposes_at_an_unknown_time_is_not_pipelined(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = _UnknownBegin(0.05).install(monkeypatch)
    assert synchronised(bench, bench, {}).pipelined is None


@pytest.mark.parametrize("overlaps", [False, True])
def test_late_pictures_of_a_sequential_acquisition_are_repeated(
    monkeypatch: pytest.MonkeyPatch, overlaps: bool
) -> None:
    bench = _UnknownBegin(0.05 if overlaps else 0.0, transfer_s=0.02)
    rig = scanned(monkeypatch, bench, late_every=9, foreign=_UNTOLD)
    assert rig.pipelined is None
    assert rig.timing.overlaps == overlaps
    assert 4 <= rig.sequential.tally.retriggered <= 16
    assert len(list(rig.photograph(pictures(), redundancy=Redundancy(pairs())))) == COUNT


def test_a_frame_that_is_lost_every_time_ends_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.05, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    bench._lost = frozenset(range(bench.exposures + 6, 10_000))
    frames = rig.photograph(pictures(), redundancy=Redundancy(pairs()))
    with pytest.raises(DeviceError, match="was lost 8 times"):
        list(frames)


def test_what_is_logged_of_a_lost_frame_keeps_nothing_alive(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """An error leads through its traceback to the frames of the whole capture, for as long as its record is kept."""
    bench = Bench(0.05, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    bench._lost = frozenset({bench.exposures + 6, bench.exposures + 11})
    with caplog.at_level("INFO"):
        assert len(list(rig.photograph(pictures(), redundancy=Redundancy(pairs())))) == COUNT
    lost = [record for record in caplog.records if "was lost" in record.message]
    assert len(lost) == 2
    assert {type(argument) for record in lost if isinstance(record.args, tuple) for argument in record.args} == {
        int,
        str,
    }


def test_a_complement_may_come_much_later(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.05, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    bench.delay_every(7)
    shown = pictures(24)
    shown = [*shown[0::2], *shown[1::2][::-1]]
    around = [(number, 23 - number) for number in range(12)]
    for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(around)), strict=True):
        np.testing.assert_allclose(frame.image, expected(picture), atol=7)
    assert rig.pipelined is not None
    assert rig.pipelined.doubted >= 2


def test_an_abandoned_scan_leaves_no_picture_in_the_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(0.12, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    frames = rig.photograph(pictures(), redundancy=Redundancy(pairs()))
    next(frames)
    del frames
    assert bench._swaps == []
    (frame,) = rig.photograph(pictures()[:1])
    np.testing.assert_allclose(frame.image, expected(pictures()[0]), atol=1)


def test_in_a_scene_that_verifies_nothing_acquisition_is_sequential(monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture's inverse is dark in this scene where neighbouring pictures differ."""
    bench = Bench(0.05, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    shown = pictures()
    for number in range(1, len(shown), 2):
        shown[number] = np.where(shown[number - 2] == 255, 0, shown[number]).astype(np.uint8)
    for picture, frame in zip(shown, rig.photograph(shown, redundancy=Redundancy(pairs())), strict=True):
        np.testing.assert_allclose(frame.image, expected(picture), atol=2)
    assert rig.pipelined is not None
    assert 6 <= rig.pipelined.doubted <= 10
    assert rig.sequential.tally.retriggered <= 10


def test_neighbouring_test_pictures_differ() -> None:
    """Otherwise frames of wrong pictures would pass."""
    assert all(np.mean(one != other) > 0.2 for one, other in pairwise(pictures()))
