"""A part of a cloud: its points, and its file."""

from pathlib import Path

import numpy as np
import pytest

from scanner.io import read_cloud
from scanner.viewing.crop import BoxFrame, box_within, frame_of, write_cropped
from scanner.viewing.result import CaptureCloud
from scanner.viewing.scene import surface_of


def whole(frame: BoxFrame) -> np.ndarray:
    return np.stack([frame.low, frame.high], axis=1)


def test_the_box_is_aligned_with_the_faces(cloud: CaptureCloud) -> None:
    frame = frame_of(cloud)
    assert frame.names == ("From face A", "From face B", "From face C")
    ranges = whole(frame)
    ranges[1] = (-np.inf, 0.02)  # within 2 cm of face B
    inside = box_within(frame, ranges).holds(cloud.points)
    on_face = cloud.matches.face == 1
    assert inside[on_face].mean() > 0.999
    assert 0.001 < inside[~on_face].mean() < 0.1


def test_without_walls_it_holds_everything(cloud: CaptureCloud) -> None:
    frame = frame_of(cloud)
    box = box_within(frame, whole(frame))
    assert not box.bounded
    assert box.holds(cloud.points).all()
    lengths = np.linalg.norm(box.edges[:, 1] - box.edges[:, 0], axis=1)
    assert sorted(lengths) == pytest.approx(sorted(np.repeat(frame.high - frame.low, 4)))


def test_the_file_holds_the_points_in_the_box(cloud: CaptureCloud, tmp_path: Path) -> None:
    frame = frame_of(cloud)
    ranges = whole(frame)
    ranges[2, 1] = (ranges[2, 0] + ranges[2, 1]) / 2
    box = box_within(frame, ranges)
    count = write_cropped(tmp_path / "part.ply", cloud, box)
    assert 100 < count < len(cloud.points)
    read = read_cloud(tmp_path / "part.ply")
    np.testing.assert_allclose(read.points, cloud.points[box.holds(cloud.points)], rtol=1e-6)
    assert "camera frame" in (tmp_path / "part.ply").read_bytes()[:300].decode("ascii")


def test_the_surface_is_between_the_points_in_the_box(cloud: CaptureCloud, monkeypatch: pytest.MonkeyPatch) -> None:
    surface = surface_of(cloud)
    assert len(surface.triangles) > len(cloud.points)  # about two for a point
    sides = np.linalg.norm(np.diff(cloud.points[surface.triangles], axis=1), axis=2)
    assert np.median(sides) < 3 * np.median(cloud.points[:, 2]) / cloud.scan.calibration.camera.focal_px[0]
    colours = np.zeros((len(cloud.points), 3), np.uint8)
    inside = cloud.points[:, 0] > np.median(cloud.points[:, 0])
    data, all_of_them = surface.glb(colours, None)
    assert data.startswith(b"glTF")
    assert all_of_them == len(surface.triangles)
    assert 0.3 < surface.glb(colours, inside)[1] / all_of_them < 0.7
    assert surface.glb(colours, np.zeros(len(cloud.points), np.bool_)) == (b"", 0)
    monkeypatch.setattr("scanner.viewing.scene._MOST_POINTS", len(cloud.points) // 4 + 1)
    coarse = surface_of(cloud)
    assert 0.15 < len(coarse.triangles) / len(surface.triangles) < 0.35
