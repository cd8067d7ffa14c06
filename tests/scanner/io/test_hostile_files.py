"""Paths that are no regular file or lead elsewhere: devices, sockets, sparse files, circular links."""

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanner.capture import open_capture
from scanner.commands import main
from scanner.errors import InputError
from scanner.io import read_calibration, read_cloud, read_image, read_matches, read_yaml
from scanner.photos import read_photos
from tests.support.little_memory import little_memory


def fifo(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def listener(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as found:
        found.bind(str(path))


def holes(path: Path) -> None:
    path.touch()
    os.truncate(path, 300_000_000)


READERS: dict[str, Callable[[Path], object]] = {
    "frame.png": read_image,
    "photo.jpg": lambda path: read_photos([path]),
    "cloud.ply": read_cloud,
    "matches.npz": read_matches,
    "room.yaml": read_yaml,
    "calibration.yaml": read_calibration,
}


@pytest.mark.parametrize("make", [fifo, device, listener, holes, Path.mkdir])
@pytest.mark.parametrize("name", READERS)
def test_only_regular_files_are_read(tmp_path: Path, monkeypatch: Any, name: str, make: Callable[[Path], None]) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's path must be short
    make(Path(name))
    with little_memory(), pytest.raises(InputError):
        READERS[name](Path(name))


def test_a_listing_outside_the_capture_is_refused(capture_folder: Path) -> None:
    (capture_folder / "capture.yaml").rename(capture_folder.parent / "elsewhere.yaml")
    (capture_folder / "capture.yaml").symlink_to(capture_folder.parent / "elsewhere.yaml")
    with pytest.raises(InputError, match="a link that leads out of the capture folder"):
        open_capture(capture_folder)


@pytest.mark.parametrize("command", ["photos", "room"])
def test_circular_links_are_refused_by_name(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, circle = tmp_path / "rig.yaml", tmp_path / "circle"
    config.write_text("camera: {width: 48, height: 32}\nprojector: {width: 48, height: 32}\n")
    circle.symlink_to("circle")
    (tmp_path / "other").mkdir()
    given = [str(circle), str(tmp_path / "other"), "--config", str(config), "--out", str(tmp_path / "out")]
    assert main([command, *given]) == 2
    assert str(circle) in capsys.readouterr().err
