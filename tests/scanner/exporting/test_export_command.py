"""`scan export`: messages on wrong arguments, and on folders without a valid result."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Matches
from scanner.io import read_cloud, read_matches, write_matches
from tests.support.command_line import run
from tests.support.result_folder import Written, corner_pose, write_captures, write_result


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
        (("--to", "ply", "--out", "file/room.ply"), ("file", "is a file, expected a folder")),
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


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[Written, Written]]:
    folder = tmp_path_factory.mktemp("captures") / "corner"
    return folder, write_captures(folder)


@pytest.mark.parametrize(("to", "name"), [("ply", "out.ply"), ("mesh", "out.ply"), ("mesh", "out.glb")])
def test_captures_of_a_corner_are_exported_together(
    captures: tuple[Path, tuple[Written, Written]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    to: str,
    name: str,
) -> None:
    folder, each_capture = captures
    counts = [len(written.scan) for written in each_capture]
    assert run("export", folder, "--to", to, "--out", tmp_path / name) == 0
    assert "of 2 captures" in capsys.readouterr().out
    if to == "ply":
        points = read_cloud(tmp_path / name).points
        assert len(points) == sum(counts)
        assert points.min() > -0.02  # in the corner's frame, all are inside of it
        assert run("export", folder, "--to", to, "--capture", "1", "--out", tmp_path / "1.ply") == 0
        assert f"{counts[0]:,} points in m" in capsys.readouterr().out
        assert np.allclose(read_cloud(tmp_path / "1.ply").points, each_capture[0].scan.points, atol=1e-5)
    elif name == "out.ply":
        points = read_cloud(tmp_path / name).points
        assert 0.99 * sum(counts) < len(points) <= sum(counts)
        assert (corner_pose(each_capture[1]) @ points).min() > -0.02


@pytest.mark.parametrize("capture", ["0", "3"])
def test_a_capture_that_is_not_there(
    captures: tuple[Path, tuple[Written, Written]], tmp_path: Path, capsys: pytest.CaptureFixture[str], capture: str
) -> None:
    assert run("export", captures[0], "--to", "ply", "--capture", capture, "--out", tmp_path / "a.ply") == 2
    assert f"expected --capture 1 to 2, found {capture}" in capsys.readouterr().err


def test_captures_that_were_not_merged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_captures(tmp_path / "corner")
    (tmp_path / "corner" / "merged.ply").unlink()
    assert run("export", tmp_path / "corner", "--to", "ply") == 2
    assert "2 captures were not merged" in capsys.readouterr().err
    assert run("export", tmp_path / "corner", "--to", "ply", "--capture", "2") == 0
