"""Several triggered cameras that see each picture together, on a bench whose clock stands still meanwhile."""

from typing import Any, cast

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.rig import Capabilities, Frames, Redundancy
from hw.timing.devices import whole_periods
from hw.timing.synchronisation import SynchronisedRig, synchronised
from scanner.patterns import Black, White, draw, level_groups, sequence_for, unpaired_bits
from tests.support.rig_bench import Bench


@pytest.mark.parametrize(
    ("wanted_ms", "refresh_hz", "periods"),
    [(33.3, 60.0, 2), (1.0, 60.0, 1), (24.9, 60.0, 1), (25.1, 60.0, 2), (33.3, 120.0, 4), (40.0, 59.94, 2)],
)
def test_exposures_are_rounded_to_whole_refresh_periods(wanted_ms: float, refresh_hz: float, periods: int) -> None:
    exposure_us, found = whole_periods(1e3 * wanted_ms, refresh_hz)
    assert found == periods
    assert exposure_us == pytest.approx(periods * 1e6 / refresh_hz)


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


LARGE = (64, 48)
PATTERNS = (White(), Black(), *sequence_for(LARGE, cell=8, inverses=True))
QUICK = sequence_for(LARGE, cell=8, inverses=False)


def before_a_wall(
    monkeypatch: pytest.MonkeyPatch, latency_s: float = 0.05, **of_the_second: Any
) -> tuple[Bench, list[BesideBench]]:
    """A projector and two cameras."""
    projector = Bench(latency_s, size=LARGE).install(monkeypatch)
    usual = {"size": LARGE, "noise": 2.0}
    return projector, [
        BesideBench(projector, name, **usual, seed=seed, **how)
        for seed, (name, how) in enumerate([("one", {}), ("two", of_the_second)])
    ]


def together(projector: Bench, cameras: list[BesideBench]) -> SynchronisedRig:
    first, *others = cameras
    return synchronised(projector, first, {}, further=[(other, {}) for other in others])


def seen(picture: np.ndarray, gain: float = 1.0) -> np.ndarray:
    lit = np.arange(picture.shape[1]) % 5 != 4
    return gain * (10 + 12 * np.where(lit, picture.astype(float), 0))


def check(pictures: list[np.ndarray], frames: list[Frames], gains: tuple[float, ...] = (1.0, 1.0)) -> None:
    """No frame has so much of another picture as verification lets pass: 2 % of white."""
    assert len(frames) == len(pictures)
    for picture, of_all in zip(pictures, frames, strict=True):
        for frame, gain in zip(of_all, gains, strict=True):
            off = frame.image - seen(picture, gain)
            assert np.abs(off).mean() < gain * 0.02 * 3070


@pytest.mark.parametrize("latency_s", [0.0, 0.05])
@pytest.mark.parametrize("other", [{}, {"exposure_s": 1 / 60, "gain": 0.5}, {"readout_s": 0.004, "lag_s": 0.002}])
def test_each_camera_has_a_frame_of_each_picture(
    monkeypatch: pytest.MonkeyPatch, latency_s: float, other: dict[str, Any]
) -> None:
    projector, cameras = before_a_wall(monkeypatch, latency_s, lost=frozenset({45, 50, 51}), **other)
    rig = together(projector, cameras)
    assert latency_s - 0.001 < rig.latency_s < latency_s + 0.008
    pictures = [draw(pattern, LARGE) for pattern in PATTERNS]
    frames = list(rig.photograph_together(pictures, redundancy=Redundancy(level_groups(PATTERNS))))
    check(pictures, frames, (1.0, other.get("gain", 1.0)))
    assert cameras[0].exposures == cameras[1].exposures


def test_two_cameras_take_as_long_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = []
    for count in (1, 2):
        projector, cameras = before_a_wall(monkeypatch)
        rig = together(projector, cameras[:count])
        assert rig.pipelined is not None
        list(
            rig.photograph_together(
                [draw(pattern, LARGE) for pattern in PATTERNS], redundancy=Redundancy(level_groups(PATTERNS))
            )
        )
        seconds.append(rig.tally.elapsed_s)
    one, two = seconds
    assert 0.9 * one < two < 1.1 * one


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("patterns", [PATTERNS, QUICK], ids=["sums", "parity"])
def test_the_frames_of_each_camera_are_verified(
    monkeypatch: pytest.MonkeyPatch, which: int, patterns: tuple[Any, ...]
) -> None:
    """One camera alone exposes so late that it sees the next picture."""
    projector, cameras = before_a_wall(monkeypatch)
    rig, late = together(projector, cameras), cameras[which]
    assert rig.pipelined is not None
    late.held_up, late.held_up_s = range(late.exposures, late.exposures + 1000, 7), 0.035
    pictures = [draw(pattern, LARGE) for pattern in patterns]
    check(
        pictures,
        list(rig.photograph_together(pictures, (), Redundancy(level_groups(patterns), unpaired_bits(patterns)))),
    )
    account = cast(dict[str, Any], rig.account()["synchronisation"])
    assert account["doubted_frames"] > 0


def test_the_camera_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    projector, cameras = before_a_wall(monkeypatch)
    rig = together(projector, cameras)
    cameras[1]._lost = frozenset(range(cameras[1].exposures, 10_000))
    with pytest.raises(DeviceError, match=r"camera two: frame 0 was lost 8 times"):
        list(rig.photograph_together([draw(pattern, LARGE) for pattern in PATTERNS]))
    with pytest.raises(DeviceError, match="camera two: it sees no difference"):
        together(*before_a_wall(monkeypatch, gain=0.0))


def test_a_camera_without_a_clock_makes_all_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    projector, cameras = before_a_wall(monkeypatch)
    monkeypatch.setattr(cameras[1], "capabilities", Capabilities())
    rig = together(projector, cameras)
    assert rig.pipelined is None
    assert 0.3 <= rig.timing.delay_s < 0.31
    pictures = [draw(pattern, LARGE) for pattern in PATTERNS[:6]]
    check(pictures, list(rig.photograph_together(pictures)))


def test_the_first_camera_alone_is_a_rig_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = together(*before_a_wall(monkeypatch))
    (frame,) = rig.photograph([draw(White(), LARGE)])
    np.testing.assert_allclose(frame.image, seen(draw(White(), LARGE)), atol=12)
