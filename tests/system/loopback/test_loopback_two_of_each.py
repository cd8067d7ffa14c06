"""A network through the real path: two cameras and two projectors, and all cameras see each picture."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any, cast

import numpy as np
import pytest
import yaml

from calib.numerics import Image
from calib.refusal import RefusalError
from hw import real_devices
from hw.aravis import backend as aravis
from hw.loopback import LitRoom, LoopbackSettings, loopback_network, own_addresses
from hw.settings import SimulatedRigSettings
from hw.simulated import Light
from scanner.capture import open_capture
from scanner.commands import main
from scanner.networks import job
from tests.support.findings import FOR_TESTS
from tests.support.loopback_bench import Keeper, wrong_frames

pytestmark = pytest.mark.xdist_group("loopback")

CAMERA, PROJECTOR = (204, 170), (213, 120)
CAMERAS, PROJECTORS = ("left", "right"), ("stage", "side")
_PUNCTUAL_S = 0.01
_ROOM = {"seed": 3, "furniture": False, "interreflection": False, "ambient": 0}


class Pair:
    """What a camera sees of one projector's pictures while the other shows black."""

    def __init__(self, room: LitRoom, projector: int) -> None:
        self._room, self._projector = room, projector
        self.sensor = room.brightest.sensor

    def electrons(self, picture: Image) -> Light:
        shown = [np.zeros_like(picture)] * len(PROJECTORS)
        shown[self._projector] = picture
        light: Light = np.sum([self._room.electrons(*each) for each in enumerate(shown)], axis=0)
        return light


@contextmanager
def watched() -> Iterator[list[float]]:
    """By how many seconds this computer woke a thread too late, each time."""
    late_s, ending = [0.0], Event()

    def watch() -> None:
        while not ending.is_set():
            begin_s = time.monotonic()
            time.sleep(0.002)
            late_s.append(time.monotonic() - begin_s - 0.002)

    thread = Thread(target=watch)
    thread.start()
    try:
        yield late_s
    finally:
        ending.set()
        thread.join()


def counted(device: Callable[..., Any], opened: list[str]) -> Callable[..., Any]:
    """The same device, whose name is noted when it is opened."""

    def noted(*how: object) -> Any:
        opened.append(device.__name__)
        return device(*how)

    return noted


def not_solved(*_: object) -> None:
    """What comes after the captures takes long, and is the same for captures of every kind."""
    raise RefusalError(FOR_TESTS, "captured only", "")


def test_a_network_of_two_cameras_and_two_projectors(
    tmp_path: Path, keeper: Keeper, monkeypatch: pytest.MonkeyPatch
) -> None:
    if len(own_addresses()) < len(CAMERAS):
        pytest.skip("a second GigE Vision camera needs a second address: this computer has no network")
    keeper.end()  # it has the address of the first camera
    monkeypatch.setattr(job, "solve_network", not_solved)
    opened: list[str] = []
    for module, name in ((real_devices, "ScreenProjector"), (aravis.load(), "AravisCamera")):
        monkeypatch.setattr(module, name, counted(getattr(module, name), opened))
    settings = {
        name: LoopbackSettings(
            camera_size=CAMERA,
            room=SimulatedRigSettings.model_validate({**_ROOM, "pose": pose}),
            projector_poses=(0, 1),
            address=address,
            serial=name,
        )
        for pose, (name, address) in enumerate(zip(CAMERAS, own_addresses(), strict=True))
    }
    with loopback_network([*settings.values()], [PROJECTOR] * 2) as screens:
        config = tmp_path / "hall.yaml"
        config.write_text(
            yaml.safe_dump(
                {
                    "rig": {"backend": "aravis", "exposure_us": 33333, "refresh_hz": 60, "packet_size": 8000},
                    "camera": {"width": CAMERA[0], "height": CAMERA[1]},
                    "projector": {"width": PROJECTOR[0], "height": PROJECTOR[1]},
                    "sequence": {"preset": "quick", "cell": 12, "inverses": True},
                    "rigs": {
                        "cameras": {name: {"rig": {"camera": each.address}} for name, each in settings.items()},
                        "projectors": {
                            name: {"rig": {"screen": screen.display}}
                            for name, screen in zip(PROJECTORS, screens, strict=True)
                        },
                    },
                }
            )
        )
        with watched() as late_s:
            code = main(["network", "--config", str(config), "--out", str(tmp_path / "hall"), "--quiet"])
    late = max(late_s) > _PUNCTUAL_S
    print(f"This computer was late by up to {1e3 * max(late_s):.0f} ms.")
    assert code == 4 or (late and code == 3)  # where frames come late eight times in a row, a scan ends
    frames = {
        first.parents[2].name: open_capture(first.parents[1])
        for first in tmp_path.glob("hall*/captures/*/capture/frames/000.png")
    }
    if code == 4:
        assert sorted(opened) == ["AravisCamera"] * 2 + ["ScreenProjector"] * 2
        assert {*frames} == {f"{camera}-{projector}" for camera in CAMERAS for projector in PROJECTORS}
        assert all(capture.patterns == capture.planned for capture in frames.values())
    for camera in CAMERAS:
        room = LitRoom(settings[camera], [PROJECTOR] * 2)
        for number, projector in enumerate(PROJECTORS):
            if (capture := frames.get(f"{camera}-{projector}")) is not None:
                assert capture.metadata["devices"]["camera"] == f"Aravis Fake {camera}"
                assert wrong_frames(capture, cast(Any, Pair(room, number)), 0.1 if late else 0.02) == []
