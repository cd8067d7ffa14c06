"""`scan register`: clouds of any scanners in one frame, with sigmas."""

import json
from pathlib import Path

import numpy as np
import pytest

from calib.deferred_imports import open3d
from calib.geometry import Pose, rotation_about
from scanner.io import read_surface
from tests.support.blob import Blob
from tests.support.command_line import names, run

pytestmark = pytest.mark.xdist_group("registering")  # what the module shares is made once
SIDES = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.5), (0.6, 0.8, 0.0))


def pose_of(number: int) -> Pose:
    """Where a cloud's frame is: X_body = R X_cloud + t."""
    rng = np.random.default_rng(number)
    return Pose(rotation_about(rng.normal(0, 1.5, 3)), rng.uniform(-200, 200, 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three views of a body, and a stranger."""
    folder, o3d = tmp_path_factory.mktemp("views"), open3d()
    views = [(Blob(), side) for side in SIDES] + [(Blob((30, 50, 45), 6.0), SIDES[0])]
    for number, (body, side) in enumerate(views):
        points, normals = body.cloud(25_000, number, side)
        back = pose_of(number).inverse()
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(back @ points))
        cloud.normals = o3d.utility.Vector3dVector(back.rotate(normals))
        o3d.io.write_point_cloud(str(folder / f"{number}.ply"), cloud)
    return folder


def test_views_are_joined_and_a_stranger_is_left_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [folder / f"{number}.ply" for number in range(4)]
    assert run("register", *given, "--out", folder / "out") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "◐ 3 of 4 clouds fit together" in told
    assert "3.ply do not fit together anywhere" in told
    assert names(folder / "out") == {"register.json", "registered.ply"}
    document = json.loads((folder / "out" / "register.json").read_text(encoding="utf-8"))
    assert [cloud["joined"] for cloud in document["clouds"]] == [True, True, True, False]
    assert len(document["pairs"]) == 6
    for number in (1, 2):
        cloud = document["clouds"][number]
        truth = pose_of(0).inverse() @ pose_of(number)
        points = pose_of(number).inverse() @ Blob().cloud(500, 9)[0]
        found = Pose(np.array(cloud["rotation"]), np.array(cloud["translation"]))
        off = np.linalg.norm(found @ points - truth @ points, axis=1)
        assert off.max() < 0.1
        assert 1e-4 < cloud["sigma"]["position"] < 0.05
        assert off.mean() < 8 * cloud["sigma"]["position"]
    joint = read_surface(folder / "out" / "registered.ply")
    assert len(joint.points) == sum(len(read_surface(path).points) for path in given[:3])
    body = pose_of(0) @ joint.points
    ways = body / np.linalg.norm(body, axis=1, keepdims=True)
    assert np.median(np.linalg.norm(body - Blob().points(ways), axis=1)) < 0.05
    assert run("register", *given, "--out", folder / "out") == 2


def test_clouds_of_different_things_are_not_joined(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("register", folder / "0.ply", folder / "3.ply", "--out", folder / "none") == 4
    assert "✕ No two of the clouds fit together in one way." in " ".join(capsys.readouterr().out.split())
    assert names(folder / "none") == {"register.json"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("0.ply",), "expected two clouds or more"),
        (("0.ply", "none.ply"), "no such file"),
        (("0.ply", "few.xyz"), "few.xyz: expected a surface, of 24 points or more, found 4"),
        (("0.ply", "text.docx"), "expected a cloud or a mesh"),
    ],
)
def test_what_cannot_be_registered_is_refused(
    arguments: tuple[str, ...],
    told: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    Path("few.xyz").write_text("0 0 0\n90 0 0\n0 60 0\n0 0 50\n")
    Path("text.docx").write_text("x")
    assert run("register", *arguments, "--out", "refused") == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not Path("refused").exists()
