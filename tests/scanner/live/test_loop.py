"""The loop around the decoder: what is kept, what ends it, and that nothing grows or blocks."""

import re
import threading
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calib.refusal import RefusalError
from hw.errors import DeviceError
from hw.rig import Rig
from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import read_matches, write_calibration
from scanner.live import jobs
from scanner.live.cloud import LiveCloud, LiveDecoder, Round
from scanner.live.first_look import FirstLook
from scanner.live.jobs import LiveResult, Watcher, Wishes, scan_live
from scanner.live.joining import keep_station
from scanner.live.rounds import best_sequence, take_rounds
from scanner.live.watching import Account, Newest, watch
from scanner.stations import given_rig, read_stations
from scanner.ui import Terminal, failure_of
from tests.scanner.live.test_clouds import DEPTHS, begun
from tests.support.live_bench import CAMERA, PROJECTOR, LiveBench, calibration

CONFIG = f"""
rig: {{backend: simulated}}
camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}}}
projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}
"""


class Acting(Watcher):
    """Runs an action for each cloud, and records the sentences."""

    def __init__(self, act: object = None) -> None:
        self._act = act
        self.told: list[str] = []

    def on_round(self, cloud: LiveCloud | None, account: Account) -> None:
        if callable(self._act):
            self._act(cloud, account)

    def tell(self, sentence: str) -> None:
        self.told.append(sentence)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> LiveBench:
    """The rig of every configuration."""
    made = LiveBench()

    @contextmanager
    def opened(_: Config) -> Iterator[Rig]:
        yield made.rig

    monkeypatch.setattr(jobs, "opened", opened)
    return made


def live(folder: Path, bench: LiveBench, wishes: Wishes, watcher: Watcher) -> LiveResult:
    (folder / "rig.yaml").write_text(CONFIG)
    write_calibration(folder / "calibration.yaml", bench.calibration)
    return scan_live(
        load_config(folder / "rig.yaml"),
        folder / "out",
        calibration=folder / "calibration.yaml",
        wishes=wishes,
        terminal=Terminal(quiet=True),
        watcher=watcher,
    )


def test_the_requested_number_of_clouds_is_kept_as_stations(tmp_path: Path, bench: LiveBench) -> None:
    found = live(tmp_path, bench, Wishes(number=2), Acting())
    assert len(found.kept) == 2
    config = load_config(tmp_path / "rig.yaml")
    given = given_rig(tmp_path / "calibration.yaml", config).given
    places = [tmp_path / "out" / "captures" / str(number) for number in (1, 2)]
    stations = read_stations(places, config, Terminal(quiet=True), given)
    for station, kept, place in zip(stations, found.kept, places, strict=True):
        np.testing.assert_array_equal(station.matches.projector_px, kept.matches.projector_px)
        assert station.texture is not None
        assert kept.texture is not None
        assert 0.8 < np.corrcoef(station.texture.ravel(), kept.texture.ravel())[0, 1] <= 1
        assert len(read_matches(place)) > 5000
    with pytest.raises(InputError, match="only one of the projector's coordinates"):
        read_stations(places, config, Terminal(quiet=True))


def test_a_cloud_is_kept_on_request(tmp_path: Path, bench: LiveBench) -> None:
    wishes = Wishes()

    def act(_: LiveCloud | None, account: Account) -> None:
        if account.clouds == 2:
            wishes.now.set()
        if account.clouds == 5:
            wishes.end.set()

    watcher = Acting(act)
    assert len(live(tmp_path, bench, wishes, watcher).kept) == 1
    (told,) = watcher.told
    assert re.match(r"Station 1 is kept: [\d,]{5,7} points, sigma 0.\d+ mm\.", told)


def test_clouds_are_kept_at_intervals(tmp_path: Path, bench: LiveBench) -> None:
    began_s = time.monotonic()
    live(tmp_path, bench, Wishes(number=3, every_s=0.2), Acting())
    assert time.monotonic() - began_s > 0.4


def opencv_without_memory() -> Exception:
    with pytest.raises(cv2.error) as caught:
        cv2.resize(np.zeros((1, 1), np.uint8), (2**31 - 1, 2**31 - 1))
    caught.value.code = cv2.Error.StsNoMem  # whatever the size was refused for
    return caught.value


@pytest.mark.parametrize(
    "error",
    [
        KeyboardInterrupt(),
        DeviceError("the camera is gone"),
        MemoryError(),
        opencv_without_memory(),
        RuntimeError("can't start new thread"),
    ],
)
def test_kept_clouds_are_saved_however_the_loop_ends(
    tmp_path: Path, bench: LiveBench, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    take = LiveBench.take

    def fail(self: LiveBench) -> object:
        if (tmp_path / ".out.partial" / "captures" / "1" / "cloud.ply").exists():
            raise error
        return take(self)

    monkeypatch.setattr(LiveBench, "take", fail)
    found = live(tmp_path, bench, Wishes(every_s=0.0), Acting())
    assert found.ended_by is error
    assert "What was kept is in" in error.__notes__[0]
    assert len(list((tmp_path / "out" / "captures").iterdir())) == len(found.kept) >= 1


def test_a_station_for_which_the_memory_was_not_enough_is_left_out(
    tmp_path: Path, bench: LiveBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep = keep_station

    def without_memory(*arguments: Any) -> object:
        kept = keep(*arguments)
        if kept.name == "Station 3":
            raise MemoryError
        return kept

    monkeypatch.setattr(jobs, "keep_station", without_memory)
    found = live(tmp_path, bench, Wishes(number=5), Acting())
    assert isinstance(found.ended_by, MemoryError)
    assert failure_of(found.ended_by).message.startswith("there is not enough memory for an input of this size")
    assert sorted(path.name for path in (tmp_path / "out" / "captures").iterdir()) == ["1", "2"]


def test_without_kept_clouds_no_folder_is_left(
    tmp_path: Path, bench: LiveBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(_: LiveBench) -> object:
        raise DeviceError("the camera is gone")

    monkeypatch.setattr(LiveBench, "take", gone)
    with pytest.raises(DeviceError):
        live(tmp_path, bench, Wishes(), Acting())
    assert not (tmp_path / "out").exists()


def test_an_error_in_the_observer_ends_the_loop(tmp_path: Path, bench: LiveBench) -> None:
    def act(_: LiveCloud | None, __: Account) -> None:
        raise DeviceError("the page is gone")

    with pytest.raises(DeviceError, match="the page is gone"):
        live(tmp_path, bench, Wishes(), Acting(act))


def test_the_newest_cloud_is_taken_and_older_ones_are_dropped() -> None:
    slot = Newest[int]()
    for number in range(5):
        slot.put(number)
    assert (slot.take(), slot.dropped) == (4, 4)
    slot.finish()
    assert slot.take() is None


def test_a_slow_observer_does_not_delay_the_camera() -> None:
    still, decoder = _still(LiveBench())
    account, began_s = Account(), time.monotonic()

    def slow(_: LiveCloud | None, __: Account) -> None:
        time.sleep(0.2)

    taken = (Round(number, each.frames, each.grey, 0.0) for number, each in enumerate(islice(cycle(still), 300)))
    watch(taken, decoder, slow, lambda: False, account)
    assert time.monotonic() - began_s < 5  # 300 × 0.2 s are a minute
    assert account.clouds + account.skipped >= 298


def test_memory_does_not_grow_over_ten_thousand_clouds() -> None:
    bench = LiveBench(calibration=calibration(smaller=8))
    everywhere = np.ones(bench.calibration.camera.size[::-1], np.bool_)
    seen = FirstLook(everywhere, (1.0, 0.02), 255.0, None)
    sequence = best_sequence(bench.rig, seen, bench.calibration, DEPTHS)
    still = [each for each in islice(take_rounds(bench.rig, sequence, None), 3) if each is not None]
    account, pages, done = Account(), list[int](), threading.Event()

    def taken() -> Generator[Round | None]:
        for number, each in enumerate(islice(cycle(still), 10_000)):
            yield Round(number, each.frames, each.grey.copy(), time.monotonic())
            assert done.wait(10), f"round {number} was not done within 10 s"
            done.clear()
            if number % 1000 == 999:
                pages.append(int(Path("/proc/self/statm").read_text().split()[1]))

    decoder = LiveDecoder(sequence, seen, bench.calibration)
    watch(taken(), decoder, lambda _, __: done.set(), lambda: False, account)
    assert account.clouds > 9_900
    assert np.median(np.diff(pages)) * 4096 < 200_000  # a frame of each cloud would be 400,000 per 1000 of them


@pytest.mark.parametrize("number", [2, None])
def test_without_any_cloud_the_loop_ends_with_an_error(tmp_path: Path, bench: LiveBench, number: int | None) -> None:
    """One frame of each round shows the previous picture; unattended, the loop would never end."""
    bench.late = frozenset(range(29, 2000, 5))
    wishes = Wishes(number=number)

    def act(_: LiveCloud | None, account: Account) -> None:
        if number is None and account.contradicting > 5:
            wishes.end.set()

    error = KeyboardInterrupt if number is None else RefusalError
    said = None if number is None else "The last 100 rounds gave no cloud: their frames contradict"
    with pytest.raises(error, match=said):
        live(tmp_path, bench, wishes, Acting(act))


def test_a_camera_that_loses_every_frame_has_failed(tmp_path: Path, bench: LiveBench) -> None:
    bench.lost = frozenset(range(29, 2000))
    with pytest.raises(DeviceError, match="10 rounds one after the other lost a frame"):
        live(tmp_path, bench, Wishes(), Acting())


def _still(bench: LiveBench) -> tuple[list[Round], LiveDecoder]:
    """Some rounds of a static scene, and their decoder."""
    seen, sequence, decoder = begun(bench)
    taken = islice(take_rounds(bench.rig, sequence, seen.response), 3)
    return [each for each in taken if each is not None], decoder
