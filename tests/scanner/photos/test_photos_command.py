"""`scan photos` end to end on photos of a painted corner, and its refusals."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from calib.geometry import Calibration, intersect
from scanner.commands import main
from scanner.io import read_calibration, read_cloud, read_matches
from scanner.viewing import ViewedResult
from tests.support.painted_corner import CAMERA, FIRST, SECOND, THIRD, Walls, painted, photo, write_photos

pytestmark = pytest.mark.xdist_group("photos command")

EXACT = ("--set", "corner.squareness_deg=0")


@pytest.fixture(scope="module")
def walls() -> Walls:
    return painted()


@pytest.fixture(scope="module")
def photos(walls: Walls, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("photos")
    return write_photos(folder, *(photo(walls, eye) for eye in (FIRST, SECOND, THIRD)))


@pytest.fixture(scope="module")
def result(photos: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of two photos, with a dense cloud."""
    out = tmp_path_factory.mktemp("results") / "two"
    assert run(*photos[:2], "--out", out, "--dense", *EXACT) == 0
    return out


def run(*arguments: object) -> int:
    return main(["photos", *(str(argument) for argument in arguments), "--quiet"])


def check_camera(calibration: Calibration, worst: float) -> None:
    focal, truth = calibration.camera.focal_px[0], CAMERA.focal_px[0]
    assert 1e-6 < abs(focal / truth - 1) < worst
    off = np.subtract(calibration.camera.principal_point_px, CAMERA.principal_point_px)
    assert 0.01 < np.abs(off).max() < worst * CAMERA.width
    assert calibration.camera == calibration.projector


def test_two_photos_give_the_camera_and_a_cloud(result: Path) -> None:
    assert {path.name for path in result.iterdir()} == {
        "calibration.yaml",
        "cloud.ply",
        "dense.ply",
        "matches.npz",
        "report.html",
        "scan.log",
    }
    calibration = read_calibration(result / "calibration.yaml")
    check_camera(calibration, 0.01)
    assert 1e-4 < calibration.sigma.camera.focal_px[0] / CAMERA.focal_px[0] < 0.01
    assert calibration.sigma.camera.focal_px[0] == calibration.sigma.projector.focal_px[0]
    assert np.linalg.norm(calibration.pose.translation) == pytest.approx(1.0)


def test_the_cloud_has_the_photos_colours_and_lies_on_the_walls(result: Path, photos: list[Path]) -> None:
    calibration, matches = read_calibration(result / "calibration.yaml"), read_matches(result)
    cloud = read_cloud(result / "cloud.ply")
    assert 0.95 * len(matches) < len(cloud) <= len(matches)
    column, row = np.rint(calibration.camera.project(cloud.points)).astype(int).T
    seen = cv2.imread(str(photos[0]))[row, column, ::-1]
    assert np.mean(np.all(cloud.colours == seen, axis=1)) > 0.9  # the others fall on the pixel beside
    # The rays of a point meet on its wall: the thickness of each is far below the room's size.
    on_wall = matches.on_face(0)
    points = intersect(on_wall, calibration).points
    spread = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1] / np.sqrt(len(points))
    assert 1e-5 < spread[2] < 0.02 * spread[0]


def test_the_dense_cloud_is_denser_and_on_the_same_walls(result: Path) -> None:
    sparse, dense = read_cloud(result / "cloud.ply"), read_cloud(result / "dense.ply")
    assert len(dense) > 20 * len(sparse)
    calibration, matches = read_calibration(result / "calibration.yaml"), read_matches(result)
    pixels = calibration.camera.project(dense.points)
    nearest = np.argmin(np.linalg.norm(matches.camera_px[:, None] - pixels[None, ::500], axis=2), axis=0)
    face = matches.face[nearest]
    for label in range(3):
        wall = intersect(matches.on_face(label), calibration).points
        centre = wall.mean(axis=0)
        normal = np.linalg.svd(wall - centre, full_matrices=False)[2][2]
        off = np.abs((dense.points[::500][face == label] - centre) @ normal)
        assert 1e-5 < np.median(off) < 0.02 * np.linalg.norm(centre)


def test_the_report_uses_the_words_for_photos(result: Path) -> None:
    text = (result / "report.html").read_text()
    assert "Between the photos" in text
    assert "<h3>The photos</h3>" in text
    assert ">Projector<" not in text
    assert "focal length, EXIF" in text


def test_matches_of_another_program_give_the_same_result(result: Path, photos: list[Path], tmp_path: Path) -> None:
    given = read_matches(result)
    np.savez(tmp_path / "m.npz", camera_px=given.camera_px, projector_px=given.projector_px)
    assert run(*photos[:2], "--matches", tmp_path / "m.npz", "--out", tmp_path / "out", *EXACT) == 0
    check_camera(read_calibration(tmp_path / "out" / "calibration.yaml"), 0.015)


def test_faces_drawn_by_hand_and_a_length_are_used(result: Path, photos: list[Path], tmp_path: Path) -> None:
    given = read_matches(result)
    (tmp_path / "masks").mkdir()
    labels = np.full((CAMERA.height, CAMERA.width), -1)
    for label in range(3):
        hull = cv2.convexHull(given.camera_px[given.face == label].astype(np.int32))
        inside = cv2.fillConvexPoly(np.zeros(labels.shape, np.uint8), hull, 1) > 0
        labels[inside & (labels < 0)] = label
    for label in range(3):
        cv2.imwrite(str(tmp_path / "masks" / f"{label}.png"), np.where(labels == label, 255, 0).astype(np.uint8))
    out = tmp_path / "out"
    arguments = ("--masks", tmp_path / "masks", "--set", "scale.baseline_m=0.64", *EXACT)
    np.savez(tmp_path / "m.npz", camera_px=given.camera_px, projector_px=given.projector_px)
    assert run(*photos[:2], "--matches", tmp_path / "m.npz", *arguments, "--out", out) == 0
    calibration = read_calibration(out / "calibration.yaml")
    check_camera(calibration, 0.03)
    assert calibration.unit == "m"
    assert calibration.baseline == pytest.approx(0.64)


def test_three_photos_are_calibrated_together(photos: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "three"
    assert run(*photos, "--out", out) == 0
    check_camera(read_calibration(out / "calibration.yaml"), 0.01)
    assert (out / "merged.ply").is_file()
    assert (out / "captures" / "1" / "matches.npz").is_file()
    assert len(read_cloud(out / "merged.ply")) > len(read_cloud(out / "cloud.ply"))
    # Every pair is in the baseline of the first two photos, and called by the numbers of its own.
    older = read_calibration(out / "captures" / "1" / "calibration.yaml")
    assert older.unit == "baseline"
    assert older.baseline == pytest.approx(np.linalg.norm(THIRD - FIRST) / np.linalg.norm(SECOND - FIRST), rel=0.01)
    viewed = ViewedResult(out)
    assert viewed.names == ("All captures, merged", "Photo 1 and photo 2", "Photo 1 and photo 3")
    places = [rig.projector_centre for rig in viewed.cloud("All captures, merged").rigs]
    apart = np.linalg.norm(places[0] - places[1]) / np.linalg.norm(
        places[0] - viewed.cloud(viewed.names[0]).rigs[0].position
    )
    assert apart == pytest.approx(np.linalg.norm(THIRD - SECOND) / np.linalg.norm(SECOND - FIRST), rel=0.01)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert all(f'"text":"photo {number}"' in page for number in (1, 2, 3))


def test_the_exif_focal_length_is_shown_and_used_only_if_asked_for(
    result: Path, photos: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = []
    for number, path in enumerate(photos[:2]):
        exif = Image.Exif()
        exif[0x0112] = 1
        exif.get_ifd(0x8769)[0xA405] = 34  # 34 / 43.27 of the diagonal of 800 px: 629 px
        paths.append(tmp_path / f"{number}.png")
        Image.open(path).save(paths[-1], exif=exif)
    given = read_matches(result)
    np.savez(tmp_path / "m.npz", camera_px=given.camera_px, projector_px=given.projector_px, face=given.face)
    arguments = [*map(str, paths), "--matches", str(tmp_path / "m.npz")]
    outs = tmp_path / "shown", tmp_path / "used"
    assert main(["photos", *arguments, "--out", str(outs[0])]) == 0
    assert "629 px (not used" in capsys.readouterr().out
    assert main(["photos", *arguments, "--exif-prior", "--out", str(outs[1])]) == 0
    assert "629 px (used as a prior" in capsys.readouterr().out
    shown, used = (yaml.safe_load((out / "calibration.yaml").read_text())["sigma"]["camera_focal_px"] for out in outs)
    assert 0 < used < shown
    assert run(*photos[:2], "--exif-prior", "--out", tmp_path / "none") == 2


def refused(capsys: pytest.CaptureFixture[str], paths: list[Path], out: Path, *words: str) -> None:
    """Exit code 4, and the matches are kept."""
    assert run(*paths, "--out", out) == 4
    message = capsys.readouterr().err
    for word in words:
        assert word in message
    assert {"matches.npz", "report.html", "scan.log"} <= {path.name for path in out.iterdir()}
    assert not (out / "calibration.yaml").exists()


def test_a_flat_wall_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wall = painted(3, walls=(0,))
    paths = write_photos(tmp_path, *(photo(wall, eye, target=np.array([0.0, 1.4, 1.4])) for eye in (FIRST, SECOND)))
    refused(capsys, paths, tmp_path / "out", "one plane was found", "flat wall")


def test_identical_photos_are_refused(walls: Walls, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = photo(walls, FIRST)
    refused(capsys, write_photos(tmp_path, same, same), tmp_path / "out", "photos from one place")


def test_a_camera_that_only_turned_is_refused(walls: Walls, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = photo(walls, FIRST), photo(walls, FIRST, target=np.array([0.4, 0.1, 0.2]))
    refused(capsys, write_photos(tmp_path, *images), tmp_path / "out", "photos from one place")


def test_unrelated_photos_are_refused(walls: Walls, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = photo(walls, FIRST), photo(painted(9), SECOND)
    refused(capsys, write_photos(tmp_path, *images), tmp_path / "out", "features of the photos match", "--matches")


def test_photos_of_nothing_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = np.full((480, 640, 3), 90, np.uint8), np.full((480, 640, 3), 91, np.uint8)
    refused(capsys, write_photos(tmp_path, *images), tmp_path / "out", "features of the photos match")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("A.png",), "two photos or more"),
        (("A.png", "A.png"), "given twice"),
        (("A.png", "missing.png"), "missing.png: cannot be read"),
        (("A.png", "text.png"), "text.png: cannot be decoded"),
        (("A.png", "small.png"), "must be of one size"),
        (("A.png", "B.png", "--matches", "wrong.npz"), "must have the shape"),
        (("A.png", "B.png", "--matches", "far.npz"), "camera_px runs from"),
        (("A.png", "B.png", "C.png", "--matches", "far.npz"), "of two photos, found 3"),
        (("A.png", "B.png", "--masks", "nowhere"), "no such folder of masks"),
        (("A.png", "B.png", "--set", "method=paper"), "method: refined"),
        (("A.png", "B.png", "--exif-prior"), "FocalLengthIn35mmFilm"),
    ],
)
def test_unusable_arguments_are_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in "ABC":
        cv2.imwrite(f"{name}.png", np.full((30, 40, 3), 100, np.uint8))
    cv2.imwrite("small.png", np.full((20, 40, 3), 100, np.uint8))
    Path("text.png").write_text("no image")
    np.savez("wrong.npz", camera_px=np.zeros((9, 2)), projector_px=np.zeros((9, 3)))
    np.savez("far.npz", camera_px=np.full((9, 2), 500.0), projector_px=np.zeros((9, 2)))
    assert run(*arguments, "--out", "out") == 2
    assert words in capsys.readouterr().err
    assert not Path("out").exists()
