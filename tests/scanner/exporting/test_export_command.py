"""`scan export`: messages on wrong arguments, and on folders without a valid result."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Matches
from scanner.io import read_matches, write_matches
from tests.support.command_line import run
from tests.support.result_folder import Written, write_result


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("intact") / "room")


@pytest.fixture
def result(intact: Written, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(intact.folder, tmp_path / "room"))


@pytest.mark.parametrize(
    ("to", "name"),
    [
        ("opencv", "room-opencv.yaml"),
        ("colmap", "room-colmap"),
        ("ply", "room-cloud.ply"),
        ("mesh", "room-mesh.glb"),
    ],
)
def test_the_default_place_is_beside_the_result(
    result: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], to: str, name: str
) -> None:
    before = sorted(path.name for path in result.iterdir())
    assert run("export", result, "--to", to) == 0
    assert str(result.parent / name) in capsys.readouterr().out
    assert {path.name for path in result.parent.iterdir()} == {"room", name}
    assert sorted(path.name for path in result.iterdir()) == before
    monkeypatch.chdir(result)
    assert run("export", ".", "--to", to) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run("export", ".", "--to", to, "--overwrite", "--quiet") == 0
    assert {path.name for path in result.parent.iterdir()} == {"room", name}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("--to",)),
        (("--to", "dxf"), ("dxf", "opencv", "colmap", "mesh")),
        (("--to", "mesh", "--out", "room.stl"), ("room.stl", ".glb or .ply or .obj")),
        (("--to", "opencv", "--out", "room.json"), ("room.json", ".yaml or .yml")),
        (("--to", "ply", "--points", "7"), ("--points is for colmap",)),
        (("--to", "colmap", "--points", "0"), ("at least 1", "found 0")),
        (("--to", "ply", "--out", "folder.ply"), ("folder.ply", "is a folder")),
        (("--to", "ply", "--out", "file/room.ply"), ("file", "cannot be made")),
    ],
)
def test_wrong_arguments(
    result: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(result.parent)
    Path("folder.ply").mkdir()
    Path("file").touch()
    assert run("export", "room", *arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    for word in words:
        assert word in output.err
    assert {path.name for path in result.parent.iterdir()} == {"room", "folder.ply", "file"}


def remove(name: str) -> Callable[[Path], object]:
    return lambda result: (result / name).unlink()


def cut(name: str, keep: int) -> Callable[[Path], object]:
    return lambda result: (result / name).write_bytes((result / name).read_bytes()[:keep])


def replace_text(name: str, old: bytes, new: bytes) -> Callable[[Path], object]:
    return lambda result: (result / name).write_bytes((result / name).read_bytes().replace(old, new, 1))


def shift_the_matches(result: Path) -> None:
    matches = read_matches(result)
    write_matches(result / "matches.npz", Matches(matches.camera_px, matches.projector_px + 3))


def forget_most_matches(result: Path) -> None:
    write_matches(result / "matches.npz", read_matches(result)[np.arange(100)])


@pytest.mark.parametrize(
    ("to", "damage", "words"),
    [
        ("opencv", shutil.rmtree, ("expected a result folder", "nothing")),
        ("opencv", remove("calibration.yaml"), ("no trustworthy calibration", "report.html")),
        ("mesh", remove("calibration.yaml"), ("no trustworthy calibration", "report.html")),
        ("ply", remove("cloud.ply"), ("cloud.ply", "cannot be read")),
        ("colmap", remove("matches.npz"), ("matches.npz", "no such")),
        ("ply", cut("cloud.ply", 5000), ("cloud.ply", "truncated")),
        ("ply", cut("cloud.ply", 0), ("cloud.ply", "expected a PLY")),
        ("ply", replace_text("cloud.ply", b"property uchar red", b"property uchar rot"), ("without red",)),
        ("ply", replace_text("cloud.ply", b"binary_little_endian", b"binary_big_endian"), ("little-endian",)),
        ("colmap", shift_the_matches, ("does not follow from", "scan replay")),
        ("mesh", forget_most_matches, ("does not follow from",)),
        ("mesh", replace_text("calibration.yaml", b"unit: m", b"unit: furlong"), ("furlong", "mm")),
        ("opencv", replace_text("calibration.yaml", b"translation", b"translatoin"), ("'translation' is missing",)),
    ],
)
def test_damaged_results(
    result: Path, capsys: pytest.CaptureFixture[str], to: str, damage: Callable[[Path], object], words: tuple[str, ...]
) -> None:
    damage(result)
    out = result.parent / {"opencv": "out.yaml", "colmap": "out", "ply": "out.ply", "mesh": "out.glb"}[to]
    assert run("export", result, "--to", to, "--out", out) == 2
    output = capsys.readouterr()
    assert output.out == ""
    for word in words:
        assert word in output.err
    assert {path.name for path in result.parent.iterdir()} <= {"room"}


def test_a_folder_that_is_no_result_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", tmp_path, "--to", "opencv") == 2
    assert "expected a result folder, with calibration.yaml and cloud.ply" in capsys.readouterr().err


def test_a_mesh_without_neighbouring_points_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room", keep=lambda pixels: pixels[:, 1] == 200)
    assert run("export", written.folder, "--to", "mesh") == 2
    assert "no three points are neighbours" in capsys.readouterr().err
    assert run("export", written.folder, "--to", "ply", "--quiet") == 0


def test_without_a_scale_the_baseline_is_exported_as_one_metre_with_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = write_result(tmp_path / "room", unit="baseline")
    assert run("export", written.folder, "--to", "mesh") == 0
    assert "one baseline, from camera to projector, was written as one metre" in capsys.readouterr().out
    assert run("export", written.folder, "--to", "mesh", "--out", tmp_path / "m.ply") == 0
    assert "in baselines" in capsys.readouterr().out


def test_without_pye57_the_extra_is_named(
    result: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pye57", None)
    assert run("export", result, "--to", "e57") == 2
    assert "E57 needs pye57, which is not installed; type: " in capsys.readouterr().err
    assert {path.name for path in result.parent.iterdir()} == {"room"}
