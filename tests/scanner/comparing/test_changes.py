"""What has changed between two scans of a room: what moved, came or went, and nothing else."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Floats
from calib.pointcloud import surface
from calib.synthetic import STATION_CAMERA, CloudErrors, FurnishedRoom, random_furnished_room, ring, seen_from
from scanner.comparing import SurfaceComparison, compare_surfaces
from scanner.io import write_ply

pytestmark = pytest.mark.xdist_group("changes")  # what the module shares is made once
MOVED = 4  # of the room's solids, the piece that is in the middle of the picture


@dataclass(frozen=True)
class Scan:
    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    colours: NDArray[np.uint8]
    unit: str = "m"


def write_scan(path: Path, room: FurnishedRoom, place: Pose, seed: int) -> Path:
    """A scan with 2 mm of noise at 3 m, as cloud.ply."""
    cloud = seen_from(room, place, np.random.default_rng(seed), CloudErrors(noise_m=0.002, shape=0.0)).points
    normals = surface(cloud, float(np.mean(STATION_CAMERA.focal_px))).normals
    points = np.where(np.isfinite(normals[..., 2:]), cloud, np.nan).astype(np.float32)
    write_ply(path, Scan(points, normals, np.full(points.shape, 128, np.uint8)))
    return path


def with_moved_piece(room: FurnishedRoom, by: Floats) -> FurnishedRoom:
    solids = list(room.scene.solids)
    normals, reach = solids[MOVED]
    solids[MOVED] = normals, reach + normals @ by
    return room._replace(scene=room.scene._replace(solids=solids))


@pytest.fixture(scope="module")
def room() -> tuple[FurnishedRoom, list[Pose]]:
    rng = np.random.default_rng(0)
    made = random_furnished_room(rng, 6)
    return made, ring(rng, made, 6, 20.0)


def compared(room: FurnishedRoom, later: FurnishedRoom, places: tuple[Pose, Pose], folder: Path) -> SurfaceComparison:
    earlier = write_scan(folder / "earlier.ply", room, places[0], 1)
    return compare_surfaces(write_scan(folder / "later.ply", later, places[1], 2), earlier)


def test_a_piece_that_moved_by_5_cm_is_the_only_change(room: tuple[FurnishedRoom, list[Pose]], tmp_path: Path) -> None:
    """Seen from elsewhere: nothing else of the room has changed."""
    made, places = room
    found = compared(made, with_moved_piece(made, np.array([0.05, 0, 0])), (places[0], places[1]), tmp_path)
    assert found.is_aligned
    assert len(found.compared) < 0.9 * len(found.distance)  # much is seen by one of them only
    assert found.changes is not None
    (change,) = found.changes
    assert change.peak == pytest.approx(0.05, abs=0.005)
    assert 2e-4 < change.sigma < 0.005
    assert change.deviating > 0.3
    piece = np.linalg.lstsq(*with_moved_piece(made, np.zeros(3)).scene.solids[MOVED], rcond=None)[0]
    assert np.linalg.norm(places[0] @ change.centre - piece) < 0.6


def test_what_came_and_what_went_is_told(room: tuple[FurnishedRoom, list[Pose]], tmp_path: Path) -> None:
    made, places = room
    away = with_moved_piece(made, np.array([30.0, 0, 0]))
    found = compared(made, away, (places[0], places[0]), tmp_path)
    assert found.changes
    assert sum(change.gone for change in found.changes) > 0.3
    assert sum(change.new for change in found.changes) < 0.1
    back = compared(away, made, (places[0], places[0]), tmp_path)
    assert back.changes
    assert sum(change.new for change in back.changes) > 0.3
    assert sum(change.gone for change in back.changes) < 0.1
