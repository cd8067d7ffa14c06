"""`scan export --to mapping`, shown by the simulator's projectors in its room: squares are square and uniform."""

import json
import shutil
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from calib.geometry import Intrinsics
from calib.numerics import Floats
from scanner.exporting import Mesh
from scanner.exporting.mapping.scene import largest_wall
from scanner.exporting.mapping.write import for_programs
from tests.support.command_line import run
from tests.support.mapped_room import (
    CAMERA,
    GAMMA,
    PROJECTORS,
    SCENE,
    shown_on_wall,
    to_network,
    write_network,
    write_projectors,
)
from tests.support.result_folder import write_result

pytestmark = pytest.mark.xdist_group("mapping")  # what the module shares is made once

Y_UP = np.array([1.0, -1.0, -1.0])
SQUARE_PX = 24  # of the content
FINE = 2  # points of the wall to a pixel of the content, along each side


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_network(tmp_path_factory.mktemp("hall") / "hall", np.random.default_rng(0))


@pytest.fixture(scope="module")
def mapping(network: Path) -> Path:
    out = network.with_name("hall-mapping")
    assert run("export", network, "--to", "mapping", "--quiet") == 0
    return out


def listing(mapping: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((mapping / "mapping.yaml").read_text())
    return found


def image(path: Path) -> Any:
    """RGB channels."""
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read is not None
    return read[..., ::-1] if read.ndim == 3 else read


def played(mapping: Path, content: Any, *, warp: str = "stmap.tiff") -> dict[str, Any]:
    """What a player shows: the content through each projector's map, times its blend map."""
    height, width = content.shape
    pictures = {}
    for name in PROJECTORS:
        found = image(mapping / f"{name}-{warp}").astype(np.float64)
        found /= 65535 if warp.endswith("png") else 1
        column, row = found[..., 0] * width - 0.5, (1 - found[..., 1]) * height - 0.5
        shown = cv2.remap(
            content,
            column.astype(np.float32),
            row.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        weight = image(mapping / f"{name}-blend.png") / 65535
        pictures[name] = np.rint(shown * weight * (found[..., 2] > 0)).astype(np.uint8)
    return pictures


def wall_through(content: dict[str, Any]) -> tuple[Floats, Floats]:
    """Points of the room's wall (H, W, 3) behind a fine grid of the content, from its upper left, and their distances
    from the content's rectangle.
    """
    width, height = content["width"] * FINE, content["height"] * FINE
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height)
    across, up = (
        side * np.array(content[axis]) for side, axis in zip(content["extent_m"], ("right", "up"), strict=True)
    )
    points = (np.array(content["lower_left"]) + x[..., None] * across + y[..., None] * up) * Y_UP
    in_room = points @ CAMERA.rotation + CAMERA.centre
    return in_room * [1.0, 0.0, 1.0], in_room[..., 1]


@pytest.mark.parametrize("warp", ["stmap.tiff", "warp.png"])
def test_squares_on_the_wall_are_square(mapping: Path, warp: str) -> None:
    found = listing(mapping)["content"]
    row, column = np.indices((found["height"], found["width"]))
    board = (255 * ((row // SQUARE_PX + column // SQUARE_PX) % 2)).astype(np.uint8)
    points, off = wall_through(found)
    assert np.abs(off).max() < 0.005
    light = shown_on_wall(played(mapping, board, warp=warp), points.reshape(-1, 3)).reshape(points.shape[:2])
    shown = (255 * light.clip(0, 1) ** (1 / GAMMA)).astype(np.uint8)
    y, x = np.mgrid[1 : found["height"] // SQUARE_PX, 1 : found["width"] // SQUARE_PX]
    expected = np.stack([x.ravel(), y.ravel()], axis=1) * SQUARE_PX
    # Where the wall is lit on all sides, and the box throws no shadow.
    white = shown_on_wall(played(mapping, np.full_like(board, 255)), points.reshape(-1, 3)).reshape(points.shape[:2])
    lit = cv2.erode((white > 0.5).astype(np.uint8), np.ones((15 * FINE, 15 * FINE), np.uint8))
    kept = [corner for corner in expected if lit[corner[1] * FINE, corner[0] * FINE]]
    start = np.array(kept, np.float32)[:, None] * FINE - 0.5
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
    corners = cv2.cornerSubPix(shown, start.copy(), (6 * FINE, 6 * FINE), (-1, -1), criteria)
    error = np.linalg.norm(corners - start, axis=2) / FINE
    assert len(kept) > 120
    assert 0.01 < np.sqrt(np.mean(error**2)) < 0.2
    assert error.max() < 0.5


def test_white_is_uniform_where_projectors_overlap(mapping: Path) -> None:
    found = listing(mapping)["content"]
    white = np.full((found["height"], found["width"]), 255, np.uint8)
    points, _ = wall_through(found)
    points = points[::FINE, ::FINE].reshape(-1, 3)
    both = played(mapping, white)
    light = shown_on_wall(both, points)
    alone = np.stack([shown_on_wall({name: both[name]}, points) for name in PROJECTORS])
    inside = cv2.erode((light > 0).reshape(white.shape).astype(np.uint8), np.ones((9, 9))).ravel() > 0
    overlap = inside & (alone.min(axis=0) > 0.05)
    assert overlap.sum() > 10_000
    assert 0.0005 < np.median(np.abs(light[overlap] - 1)) < 0.005
    assert np.quantile(np.abs(light[overlap] - 1), 0.95) < 0.02  # the rest is at the edges of the box
    assert np.quantile(alone[0][overlap], [0.1, 0.9]) == pytest.approx([0.2, 0.8], abs=0.2)


def test_weights_add_up_to_one(mapping: Path) -> None:
    """At pixels of one projector, plus those of the other at the same points."""
    seen = {name: image(mapping / f"{name}-position.tiff") for name in PROJECTORS}
    weights = {name: (image(mapping / f"{name}-blend.png") / 65535) ** GAMMA for name in PROJECTORS}
    points = seen["left"].reshape(-1, 3) * Y_UP @ CAMERA.rotation + CAMERA.centre
    x, y = PROJECTORS["right"].project(points.T)[0].astype(np.float32).reshape(2, *weights["left"].shape)
    other = cv2.remap(weights["right"], x, y, cv2.INTER_LINEAR).ravel()
    total = weights["left"].ravel() + other
    shared = (np.abs(points[:, 1]) < 0.01) & (other > 0.02) & (weights["left"].ravel() > 0.02)
    assert shared.sum() > 10_000
    assert 1e-5 < np.median(np.abs(total[shared] - 1)) < 1e-3
    assert np.quantile(np.abs(total[shared] - 1), 0.95) < 0.01


def test_maps_cover_what_each_projector_lights(mapping: Path) -> None:
    for name, projector in PROJECTORS.items():
        depth, position = image(mapping / f"{name}-depth.tiff"), image(mapping / f"{name}-position.tiff")
        rows, columns = np.indices(depth.shape)
        rays = projector.rays(np.stack([columns.ravel(), rows.ravel()]).astype(np.float64))
        true, surface = SCENE.cast(projector.centre[:, None], rays)
        off = depth.ravel() - true
        on_wall = (surface == 1) & (depth.ravel() > 0)
        assert on_wall.mean() > 0.8
        assert 1e-5 < np.median(np.abs(off[on_wall])) < 1e-3
        assert np.mean(np.abs(off) < 0.01) > 0.97  # all but the edges of the box
        points = to_network((projector.centre[:, None] + true * rays).T) * Y_UP
        assert np.quantile(np.linalg.norm(position.reshape(-1, 3) - points, axis=1)[on_wall], 0.99) < 0.005


def test_from_a_viewpoint_the_box_continues_the_picture_of_the_wall(network: Path, tmp_path: Path) -> None:
    eye = np.array([2.0, 2.2, 1.5])
    told = ",".join(f"{value:.9f}" for value in to_network(eye) * Y_UP)
    assert run("export", network, "--to", "mapping", "--out", tmp_path / "m", f"--eye={told}", "--quiet") == 0
    found = listing(tmp_path / "m")["content"]
    corner, axes = np.array(found["lower_left"]), np.array([found["right"], found["up"]])
    for name, projector in PROJECTORS.items():
        warp = image(tmp_path / "m" / f"{name}-stmap.tiff")
        rows, columns = np.nonzero(warp[..., 2])
        rays = projector.rays(np.stack([columns, rows]).astype(np.float64))
        t, surface = SCENE.cast(projector.centre[:, None], rays)
        lit = projector.centre[:, None] + t * rays
        behind = eye[:, None] + (lit - eye[:, None]) * eye[1] / (eye[1] - lit[1])  # on the wall, y = 0
        at = ((to_network(behind.T) * Y_UP - corner) @ axes.T) / found["extent_m"]
        off_px = (at - warp[rows, columns, :2]) * [found["width"], found["height"]]
        front = surface == 6 + 4
        assert front.sum() > 1000
        for part in (front, surface == 1):
            assert 0.001 < np.median(np.linalg.norm(off_px[part], axis=1)) < 0.3


def test_a_projector_is_exported_as_a_camera_of_the_scene(mapping: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    scene = trimesh.load(mapping / "mapping.glb", process=False)
    (mesh,) = scene.geometry.values()
    in_room = mesh.vertices * Y_UP @ CAMERA.rotation + CAMERA.centre
    assert np.median(np.abs(in_room[np.abs(in_room[:, 1]) < 0.02, 1])) < 1e-3
    for name, projector in PROJECTORS.items():
        matrix = scene.graph.get(name)[0]
        assert matrix[:3, 3] == pytest.approx(to_network(projector.centre) * Y_UP, abs=1e-6)
        ahead = to_network(projector.centre + projector.rotation[2]) * Y_UP - matrix[:3, 3]
        assert -matrix[:3, 2] == pytest.approx(ahead, abs=1e-6)
    data = (mapping / "mapping.glb").read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    nodes = {node["name"]: node for node in document["nodes"]}
    listed = {each["name"]: each for each in listing(mapping)["projectors"]}
    for name, projector in PROJECTORS.items():
        optics, lens = projector.optics, document["cameras"][nodes[name]["camera"]]["perspective"]
        assert np.tan(lens["yfov"] / 2) == pytest.approx(optics.height / 2 / optics.focal_px)
        assert lens["aspectRatio"] == pytest.approx(optics.width / optics.height)
        depth = image(mapping / f"{name}-depth.tiff")
        assert 0 < lens["znear"] < depth[depth > 0].min() < depth.max() < lens["zfar"] < 10
        assert nodes[name]["extras"] == listed[name]["programs"]


def rectangle(origin: Any, across: Any, along: Any) -> tuple[Floats, Floats, Any]:
    """Points, normals and triangles of a grid of 20 × 20 points with a millimetre of noise."""
    shares = np.stack(np.meshgrid(*[np.linspace(0, 1, 20)] * 2), axis=-1).reshape(-1, 2)
    normal = np.cross(across, along) / np.linalg.norm(np.cross(across, along))
    rough = 1e-3 * np.random.default_rng(0).standard_normal((400, 1)) * normal
    corner = (np.arange(19)[:, None] * 20 + np.arange(19)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 1, 21], corner[:, None] + [0, 21, 20]])
    return np.array(origin) + shares @ np.array([across, along]) + rough, np.tile(normal, (400, 1)), triangles


def test_the_largest_upright_plane_is_the_wall() -> None:
    parts = (
        rectangle((-1.0, -1.0, 3.0), (0, 1.5, 0), (1.0, 0, 0)),
        rectangle((0.2, -1.0, 4.0), (0, 1.5, 0), (1.6, 0, 0)),
        rectangle((-3.0, -1.0, 3.5), (0, 1.5, 0), (1.2, 0, 0)),
        rectangle((-2.0, 1.0, 0.0), (0, 0, 4.0), (4.0, 0, 0)),  # the floor
    )
    points, normals = (np.concatenate([part[number] for part in parts]) for number in (0, 1))
    triangles = np.concatenate([part[2] + 400 * number for number, part in enumerate(parts)])
    colours = np.zeros((len(points), 3), np.uint8)
    wall = largest_wall(Mesh(points, normals, colours, triangles, "m"))
    assert wall.normal == pytest.approx([0, 0, -1], abs=1e-3)
    assert wall.offset == pytest.approx(-4, abs=1e-3)
    upright = triangles < 1200
    floor = largest_wall(Mesh(points, normals, colours, triangles[~upright.any(axis=1)], "m"))
    assert np.abs(floor.normal) == pytest.approx([0, 1, 0], abs=1e-3)


@pytest.mark.parametrize("focal_px", [(900.0, 900.0), (900.0, 870.0)])
def test_shifts_project_as_the_projector_does(focal_px: tuple[float, float]) -> None:
    """Each program's formula, from its source or manual, compared with the pinhole."""
    device = Intrinsics(854, 480, focal_px, (391.2, 611.7))
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (500, 2)), rng.uniform(2, 5, 500)])
    expected = device.project(points) + 0.5
    x, y, depth = points[:, 0], -points[:, 1], points[:, 2]
    found = for_programs(device, 0.1, 20.0)

    blender = found["blender"]  # blenkernel/intern/camera.cc: the view plane at a distance of one
    aspect = blender["pixel_aspect_y"] / blender["pixel_aspect_x"]
    size = blender["sensor_width"] / blender["lens"] / 854
    left, bottom = (-854 / 2 + blender["shift_x"] * 854) * size, (-480 / 2 * aspect + blender["shift_y"] * 854) * size
    at = np.column_stack([(x / depth - left) / size, 480 - (y / depth - bottom) / (size * aspect)])
    assert np.abs(at - expected).max() < 1e-6

    unity = found["unity"]
    plane = (np.stack([x, y], axis=1) / depth[:, None]) * unity["focalLength"] / unity["sensorSize"]
    share = plane - unity["lensShift"] + 0.5
    assert np.abs(share * [854, -480] + [0, 480] - expected).max() < 1e-6

    angles = {side: np.tan(np.radians(found["unreal_ndisplay_manual"][f"Angle{side}"])) for side in "LRTB"}
    across = (x / depth - angles["L"]) / (angles["R"] - angles["L"])
    down = (angles["T"] - y / depth) / (angles["T"] - angles["B"])
    assert np.abs(np.column_stack([854 * across, 480 * down]) - expected).max() < 1e-6

    clip = np.column_stack([x, y, -depth, np.ones(500)]) @ np.array(found["touchdesigner_projection_matrix"]).T
    screen = clip[:, :3] / clip[:, 3:]
    assert np.abs((screen[:, :2] * [1, -1] + 1) / 2 * [854, 480] - expected).max() < 1e-6
    assert screen[:, 2] == pytest.approx(20 * (depth - 0.1) / (19.9 * depth))


def test_a_network_without_a_length_names_its_baseline(
    network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = Path(shutil.copytree(network, tmp_path / "hall"))
    change("unit: m", "unit: baseline")(result)
    assert run("export", result, "--to", "mapping") == 0
    assert "one baseline, from camera to left, was written as one metre" in capsys.readouterr().out


def test_a_single_rig_has_one_projector(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room", unit="mm")
    assert run("export", written.folder, "--to", "mapping") == 0
    assert "1 projector as a camera" in capsys.readouterr().out
    (projector,) = listing(tmp_path / "room-mapping")["projectors"]
    calibration = written.scan.calibration
    assert projector["position"] == pytest.approx(1e-3 * calibration.projector_centre * Y_UP)
    blend = image(tmp_path / "room-mapping" / "projector-blend.png")
    shown = image(tmp_path / "room-mapping" / "projector-stmap.tiff")[..., 2] > 0
    assert 0.05 < shown.mean() < 0.9
    assert np.array_equal(np.unique(blend), [0, 65535])
    assert np.array_equal(blend > 0, shown)


def change(text: str, new: str) -> Any:
    def apply(folder: Path) -> None:
        file = folder / "network.yaml"
        file.write_text(file.read_text().replace(text, new))

    return apply


def scatter(folder: Path) -> None:
    """A cloud of a few points."""
    header, end, body = (folder / "network.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    short = "\n".join("element vertex 20" if line.startswith("element vertex") else line for line in lines)
    (folder / "network.ply").write_bytes(short.encode() + b"\n" + end + body)


def in_one_place(folder: Path) -> None:
    """All points equal the first one."""
    header, end, body = (folder / "network.ply").read_bytes().partition(b"end_header\n")
    (folder / "network.ply").write_bytes(header + end + body[:27] * (len(body) // 27))


def peak_bytes(folder: Path, count: int, size: tuple[int, int]) -> int:
    """The most memory that NumPy takes for a mapping of projectors."""
    write_projectors(folder, count, size)
    tracemalloc.start()
    try:
        assert run("export", folder, "--to", "mapping", "--quiet") == 0
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_is_that_of_one_projectors_maps(tmp_path: Path) -> None:
    small, large, three = (320, 200), (1600, 1000), 3
    further = peak_bytes(tmp_path / "large", three, large) - peak_bytes(tmp_path / "small", three, small)
    # Of whole maps in double precision it was 140 bytes, for each projector.
    assert 4 < further / (large[0] * large[1] - small[0] * small[1]) < 25


@pytest.mark.parametrize(
    ("place", "expected", "code", "words"),
    [
        (
            "scanner.io.free_memory.free_bytes",
            3_000_000_000,
            2,
            "of up to 225.0 megapixels take about 3.5 GB of memory",
        ),
        ("os.statvfs", SimpleNamespace(f_bavail=1, f_frsize=1, f_files=0), 3, "needs up to 22.5 GB, but 0 MB are free"),
    ],
)
def test_what_does_not_fit_is_refused_before_it_begins(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    place: str,
    expected: object,
    code: int,
    words: str,
) -> None:
    write_projectors(tmp_path / "hall", 2, (15_000, 15_000))
    monkeypatch.setattr(place, lambda *_: expected)
    assert run("export", tmp_path / "hall", "--to", "mapping") == code
    assert words in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["hall"]


def of_stations(folder: Path) -> None:
    (folder / "network.yaml").rename(folder / "room.yaml")


@pytest.mark.parametrize(
    ("damage", "arguments", "words"),
    [
        (change("kind: projector", "kind: camera"), (), "has no projector, so there is nothing to map"),
        (change("kind: projector", "kind: lamp"), (), "devices[1].kind"),
        (change("name: left", "name: ../left"), (), "devices[1].name"),
        (change("name: left", "name: right"), (), "two devices that are called right"),
        (scatter, (), "do not hang together as a surface"),
        (in_one_place, (), "do not hang together as a surface"),
        (of_stations, (), "was moved between its stations"),
        (lambda folder: (folder / "network.ply").unlink(), (), "network.ply"),
        (lambda folder: (folder / "network.yaml").unlink(), (), "expected a result folder"),
        (None, ("--eye=0,0,-40",), "behind the largest wall"),
        (None, ("--eye=1,2",), "expected three numbers"),
        (None, ("--eye=1,2,nan",), "expected three numbers"),
        (None, ("--gamma", "0"), "--gamma: expected 0.1 to 10"),
        (None, ("--to", "ply", "--gamma", "2"), "--eye and --gamma are for mapping"),
    ],
)
def test_scenes_that_cannot_be_mapped_are_refused(
    network: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Any,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    result = Path(shutil.copytree(network, tmp_path / "hall"))
    if damage:
        damage(result)
    assert run("export", result, "--to", "mapping", *arguments) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["hall"]
