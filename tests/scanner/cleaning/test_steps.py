"""Steps on the cloud of a simulated capture: what stays is what the truth says, and the cloud itself is untouched."""

from pathlib import Path

import numpy as np
import pytest

from scanner.cleaning import read_cleaned
from scanner.commands import main
from scanner.configuration import CloudStep, load_config
from scanner.errors import InputError
from scanner.io import read_cloud
from scanner.results import new_result, read_steps
from tests.support.cloud_scene import SPHERE_RADIUS_M
from tests.support.result_folder import Written, write_captures, write_result


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("cleaning") / "room", noise_px=0.2)


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cleaning") / "two"
    write_captures(folder)
    return folder


def clean(result: Path, *options: str) -> int:
    return main(["clean", str(result), "--quiet", *options])


def around_ball(written: Written, margin: float = 1.05) -> str:
    centre = written.scene.sphere_centre
    reach = margin * SPHERE_RADIUS_M
    return ",".join(f"{value:.6f}" for value in (*(centre - reach), *(centre + reach)))


@pytest.fixture
def fresh(written: Written) -> Written:
    (written.folder / "steps.yaml").unlink(missing_ok=True)
    return written


def test_a_box_is_in_every_export_and_undone(fresh: Written, tmp_path: Path) -> None:
    folder, before = fresh.folder, (fresh.folder / "cloud.ply").read_bytes()
    box = around_ball(fresh)
    low, high = np.array(box.split(","), float).reshape(2, 3)
    inside = np.all((fresh.scan.points >= low) & (fresh.scan.points <= high), axis=1)
    assert 500 < inside.sum() < 0.2 * len(inside)
    assert clean(folder, f"--box={box}") == 0
    for to, out in (
        ("ply", "a.ply"),
        ("pcd", "a.pcd"),
        ("e57", "a.e57"),
        ("colmap", "a"),
        ("mesh", "a.ply"),
        ("stl", "a.stl"),
        ("mapping", "b"),
    ):
        if to == "e57":
            pytest.importorskip("pye57")
        assert main(["export", str(folder), "--to", to, "--out", str(tmp_path / to / out), "--quiet"]) == 0
    cloud = read_cloud(tmp_path / "ply" / "a.ply")
    assert np.array_equal(cloud.points, fresh.scan.points[inside])
    assert np.array_equal(cloud.colours, fresh.scan.colours[inside])
    for name in ("mesh/a.ply",):
        points = read_cloud(tmp_path / name).points
        assert 500 < len(points) <= inside.sum()
        assert np.all((points >= low - 1e-6) & (points <= high + 1e-6))
    lines = (tmp_path / "colmap" / "a" / "points3D.txt").read_text().splitlines()[1:]
    placed = np.array([line.split()[1:4] for line in lines], float)
    assert 500 < len(placed) <= inside.sum()
    assert np.all((placed >= low - 1e-6) & (placed <= high + 1e-6))
    assert (folder / "cloud.ply").read_bytes() == before
    assert clean(folder, "--undo") == 0
    assert not (folder / "steps.yaml").exists()
    assert main(["export", str(folder), "--to", "ply", "--out", str(tmp_path / "c.ply"), "--quiet"]) == 0
    assert (tmp_path / "c.ply").read_bytes() == before


def test_steps_are_in_the_order_of_the_command_line(fresh: Written) -> None:
    assert clean(fresh.folder, "--outliers", "--pieces", "5cm", "--outliers", "2") == 0
    assert clean(fresh.folder, "--fill", "2cm") == 0
    assert [str(step) for step in read_steps(fresh.folder)] == [
        "outliers 3.0",
        "pieces 5cm",
        "outliers 2.0",
        "fill 2cm",
    ]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--box=5,5,5,6,6,6"], "leaves none of"),
        (["--box=0,0,0,1,1"], "expected 6 lengths"),
        (["--box=0,0,0,1,1,0"], "coordinate in common"),
        (["--box=0,0,0,1,1,1furlong"], "furlong"),
        (["--triangles", "0"], "greater than or equal to 4"),
        (["--triangles", "1000000000000"], "expected fewer than the mesh has"),
        (["--triangles", "10000000000000"], "less than or equal"),
        (["--fill", "50m"], "below that of the surface"),
        (["--outliers", "nan"], "finite"),
        (["--pieces", "30m"], "leaves none"),
        (["--axes", "0,0,0,1,0,0,2,0,0"], "on a line"),
        (["--undo"], "no step to undo"),
        (["--undo", "--floor"], "no other step"),
    ],
)
def test_what_cannot_be_done_is_answered_by_name(
    fresh: Written, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert clean(fresh.folder, *options) == 2
    assert said in capsys.readouterr().err
    assert not (fresh.folder / "steps.yaml").exists()


@pytest.mark.parametrize(
    "text",
    [
        "steps: 5",
        "steps: [{box: 3}]",
        "steps: [{}]",
        "steps: [{smooth: false}]",
        "steps: [{spin: 3}]",
        "\x00",
        "[",
        "steps: [{outliers: 3, smooth: true}]",
        "steps: [" + ",".join(["{smooth: true}"] * 65) + "]",
    ],
)
def test_a_corrupted_file_of_steps_is_named(fresh: Written, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (fresh.folder / "steps.yaml").write_text(text)
    assert clean(fresh.folder) == 2
    assert "steps.yaml" in capsys.readouterr().err
    assert main(["export", str(fresh.folder), "--to", "pcd"]) == 2


def test_lengths_with_a_unit_need_a_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_result(tmp_path / "room", unit="baseline").folder
    assert clean(folder, "--pieces", "5cm") == 2
    assert "unit is the baseline" in capsys.readouterr().err
    assert main(["clean", str(folder), "--pieces", "0.05"]) == 0
    assert "lengths are in baselines" in capsys.readouterr().out


def test_outliers_and_small_pieces_go_and_the_rest_stays(written: Written) -> None:
    """The ball hangs in the air: it is a piece of 0.3 m."""
    points, scan = written.scan.points, written.scan
    far_off = np.abs(np.linalg.norm(points - written.scene.sphere_centre, axis=1) - SPHERE_RADIUS_M) < 0.03
    for size, ball_stays in (("0.2", True), ("0.6", False)):
        left = read_cleaned(written.folder, steps=[CloudStep(pieces=size)]).clouds()[-1].number
        share = np.isin(np.flatnonzero(far_off), left).mean()
        assert share > 0.9 if ball_stays else share < 0.3
        assert np.isin(np.flatnonzero(~far_off), left).mean() > 0.99
    left = read_cleaned(written.folder, steps=[CloudStep(outliers=3.0)]).clouds()[-1].number
    assert 0.95 < len(left) / len(scan) < 1


def test_smoothing_lowers_noise_and_rounds_no_edge(written: Written) -> None:
    """On the walls noise falls by two to six; within 2 cm of their edges no point is pulled off its wall by more."""
    cleaned = read_cleaned(written.folder, steps=[CloudStep(smooth=True)])
    (station,) = cleaned.stations
    smooth, raw, scene = station.scan.points, written.scan.points, written.scene
    corner = scene.corner
    from_walls = np.abs((raw - corner.vertex) @ corner.normals.T)
    wall = np.argmin(from_walls, axis=1)
    on_ball = np.abs(np.linalg.norm(raw - scene.sphere_centre, axis=1) - SPHERE_RADIUS_M) < 0.02
    to_edge = np.sort(from_walls, axis=1)[:, 1]

    def off(points: np.ndarray, which: np.ndarray) -> np.ndarray:
        return np.sum((points - corner.vertex) * corner.normals[wall], axis=1)[which]

    inner = ~on_ball & (from_walls.min(axis=1) < 0.02) & (to_edge > 0.1)
    gain = np.std(off(raw, inner)) / np.std(off(smooth, inner))
    assert 2 < gain < 6
    edge = ~on_ball & (from_walls.min(axis=1) < 0.02) & (to_edge < 0.02)
    noise = np.std(off(raw, inner))
    assert edge.sum() > 100
    before, after = np.abs(np.mean(off(raw, edge))), np.abs(np.mean(off(smooth, edge)))
    assert 0 <= after < before + 0.2 * noise
    assert 0.1 < np.std(off(smooth, edge)) / np.std(off(raw, edge)) < 1.05
    ball = np.linalg.norm(smooth - scene.sphere_centre, axis=1)[on_ball] - SPHERE_RADIUS_M
    raw_ball = np.linalg.norm(raw - scene.sphere_centre, axis=1)[on_ball] - SPHERE_RADIUS_M
    assert abs(np.median(ball) - np.median(raw_ball)) < 0.2 * noise
    assert 0.1 < np.std(ball) / np.std(raw_ball) < 0.8


def test_the_floor_is_the_origin_below_the_camera(written: Written) -> None:
    cleaned = read_cleaned(written.folder, steps=[CloudStep(floor=True)])
    assert cleaned.axes is not None
    cloud = cleaned.cloud()
    normals, vertex = written.scene.corner.normals, written.scene.corner.vertex
    upward = int(np.argmax(normals @ [0, -1, 0]))
    on_floor = np.abs((written.scan.points - vertex) @ normals[upward]) < 0.005
    assert on_floor.sum() > 5000
    assert abs(np.mean(cloud.points[on_floor, 2])) < 1e-3
    assert np.quantile(cloud.points[:, 2], 0.01) > -0.01
    eye = cleaned.axes @ np.zeros(3)
    assert abs(eye[0]) + abs(eye[1]) < 1e-9
    assert eye[2] == pytest.approx(-vertex @ normals[upward], abs=2e-3)
    assert cleaned.axes.rotation @ normals[upward] == pytest.approx([0, 0, 1], abs=2e-3)


def test_holes_are_closed_and_triangles_reduced(fresh: Written, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")

    def mesh(*options: str):  # type: ignore[no-untyped-def]
        assert clean(fresh.folder, *options) == 0
        out = tmp_path / f"{len(list(tmp_path.iterdir()))}.ply"
        assert main(["export", str(fresh.folder), "--to", "mesh", "--out", str(out), "--quiet"]) == 0
        return trimesh.load(out, process=False)

    whole, reduced = mesh(), mesh("--triangles", "3000")
    assert 2900 <= len(reduced.faces) <= 3000 < len(whole.faces)
    assert 0.8 < reduced.area / whole.area < 1  # noise makes a surface larger


def test_a_box_of_two_captures_is_in_their_frame_and_in_one_of_them(captures: Path, tmp_path: Path) -> None:
    box = "0.1,0.1,0.1,0.9,0.9,0.9"
    steps = [CloudStep(box=box)]
    merged = read_cleaned(captures, steps=steps).cloud()
    assert 100 < len(merged) < len(read_cleaned(captures).cloud())
    assert merged.points.min() >= 0.1
    assert merged.points.max() <= 0.9
    assert "corner frame" in merged.frame
    count = 0
    for number in (1, 2):
        cleaned = read_cleaned(captures, number, steps)
        (station,), (same,) = cleaned.stations, read_cleaned(captures, number).stations
        assert np.array_equal(station.place.matrix, same.place.matrix)
        own = cleaned.cloud()
        assert np.array_equal(own.points, station.scan.points)
        count += len(own)
    assert count == len(merged)


def test_one_of_several_captures_has_the_floor_of_all(captures: Path) -> None:
    whole = read_cleaned(captures, steps=[CloudStep(floor=True)])
    for number in (1, 2):
        cleaned = read_cleaned(captures, number, [CloudStep(floor=True)])
        (station,) = cleaned.stations
        assert np.allclose(cleaned.cloud().points, station.place @ station.scan.points, atol=1e-9)
        assert np.allclose(station.place.matrix, whole.stations[number - 1].place.matrix, atol=1e-12)


def test_axes_and_smoothing_of_several_captures(captures: Path) -> None:
    with pytest.raises(InputError, match="one capture"):
        read_cleaned(captures, steps=[CloudStep(smooth=True)])
    cleaned = read_cleaned(captures, steps=[CloudStep(axes="1,0,0,1,1,0,0,0,0")])
    raw = read_cleaned(captures).cloud().points
    expected = np.stack([raw[:, 1], 1 - raw[:, 0], raw[:, 2]], axis=1)
    assert np.allclose(cleaned.cloud().points, expected, atol=1e-9)
    placed = np.concatenate([s.place @ s.scan.points for s in cleaned.stations_before_camera])
    assert np.allclose(placed, expected, atol=1e-6)


def test_the_viewer_shows_what_the_steps_leave_in_the_results_axes(fresh: Written) -> None:
    pytest.importorskip("viser")
    from scanner.viewing import ViewedResult

    assert clean(fresh.folder, f"--box={around_ball(fresh)}", "--floor") == 0
    viewed = ViewedResult(fresh.folder)
    cloud = viewed.cloud(viewed.names[0])
    expected = read_cleaned(fresh.folder, own_axes=True).cloud().points
    assert 500 < len(cloud.points) < 0.2 * len(fresh.scan)
    assert np.array_equal(cloud.points, expected)
    assert cloud.scans is not None
    assert np.array_equal(cloud.scans.position(cloud.point_number(17)), expected[17])
    assert cloud.scans is not None
    assert np.array_equal(cloud.scans.position(cloud.point_number(17)), expected[17])


def test_a_configuration_gives_a_result_its_steps(tmp_path: Path) -> None:
    config = load_config(None, ["cloud.box='0,0,0,1,1,1'", "cloud.steps=[{outliers: 2.5}]"])
    with new_result(tmp_path / "room", config, overwrite=False) as folder:
        (folder / "cloud.ply").write_bytes(b"")
    assert [str(step) for step in read_steps(tmp_path / "room")] == ["box 0,0,0,1,1,1", "outliers 2.5"]
    with new_result(tmp_path / "board", config, overwrite=False):
        pass
    assert not (tmp_path / "board" / "steps.yaml").exists()
