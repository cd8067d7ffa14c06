"""The mesh with the stations' pictures: the paint is known, and is lit from one side at each station.

Noise is reduced, relief is kept.
"""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.numerics import Floats
from scanner.exporting import Piece, write_pieces
from scanner.results import GivenMatches
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.mesh import CAMERA_FROM_ROOM, denoised, fused
from scanner.rooms.textures import PointsInPicture, in_common_light, textured
from tests.scanner.rooms.conftest import SolvedExample


def painted(points: Floats) -> Floats:
    """Waves in the room (N, 3) in metres, half a metre long: (N,) from 20 to 180 of 255."""
    return np.asarray(100 + 80 * np.prod(np.sin(2 * np.pi * points / 0.5 + [0.3, 0.7, 1.1]), axis=1))


def lit(station: Station, side: int) -> Station:
    """The station with a picture that is brighter towards one side."""
    height, width = station.cloud.there.shape
    points = np.nan_to_num(station.to_room(station.cloud.points.astype(np.float64)))
    light = np.linspace(0.7, 1.3, width)[:: 1 if side else -1]
    picture = np.rint(painted(points.reshape(-1, 3)).reshape(height, width) * light).astype(np.uint8)
    colours = np.where(station.cloud.there[..., None], picture[..., None], 0).repeat(3, axis=2).astype(np.uint8)
    decoded = replace(station.decoded, origin=GivenMatches(picture))
    return replace(station, decoded=decoded, cloud=replace(station.cloud, colours=colours))


@pytest.fixture(scope="module")
def room(example: SolvedExample) -> SolvedRoom:
    stations = tuple(lit(station, number % 2) for number, station in enumerate(example.solved.stations))
    return replace(example.solved, stations=stations)


@pytest.fixture(scope="module")
def pieces(room: SolvedRoom) -> list[Piece]:
    return textured(room.stations, room.calibration, fused(room))


def shades(piece: Piece) -> Floats:
    """The colour of the picture at each vertex, (N,)."""
    picture = cv2.imdecode(np.frombuffer(piece.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    height, width = picture.shape
    at = (piece.places * [width, height] - 0.5).astype(np.float32)
    rows = [
        cv2.remap(picture, x[:, None], y[:, None], cv2.INTER_LINEAR)
        for x, y in ((part[:, 0], part[:, 1]) for part in np.array_split(at, 1 + len(at) // 10_000))
    ]
    return np.concatenate(rows).ravel().astype(np.float64)


def test_textures_match_the_painted_walls(room: SolvedRoom, pieces: list[Piece]) -> None:
    under_pictures = [piece for piece in pieces if piece.jpeg]
    assert len(under_pictures) == len(room.stations)
    share = sum(len(piece.mesh.triangles) for piece in under_pictures) / sum(len(p.mesh.triangles) for p in pieces)
    assert 0.9 < share <= 1.0
    for piece in under_pictures:
        paint = painted(piece.mesh.points @ CAMERA_FROM_ROOM)
        # What is left is light that is not the same all over, and pixels of 13 mm before waves of half a metre.
        assert 0.85 < np.corrcoef(shades(piece), paint)[0, 1] < 0.9999


def test_textures_agree_at_seams(pieces: list[Piece]) -> None:
    """Vertices at seams are duplicated."""
    at: dict[tuple[float, ...], list[float]] = {}
    for piece in pieces:
        if piece.jpeg:
            for point, shade in zip(piece.mesh.points.round(6).tolist(), shades(piece).tolist(), strict=True):
                at.setdefault(tuple(point), []).append(shade)
    off = [max(both) - min(both) for both in at.values() if len(both) > 1]
    assert len(off) > 100
    assert 0.5 < np.median(off) < 8  # of 100; the light differs by up to 60


def test_files_are_gltf_with_embedded_pictures(pieces: list[Piece], tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    path = tmp_path / "room.glb"
    write_pieces(path, pieces, 1.0)
    scene = trimesh.load(path, process=False)
    found = list(scene.geometry.values())
    assert [len(each.faces) for each in found] == [len(piece.mesh.triangles) for piece in pieces]
    for each, piece in zip(found, pieces, strict=True):
        if piece.jpeg:
            assert (
                each.visual.material.baseColorTexture.size
                == cv2.imdecode(np.frombuffer(piece.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE).shape[::-1]
            )
            # trimesh counts from below, as OpenGL does
            assert np.allclose(np.asarray(each.visual.uv) * [1, -1] + [0, 1], piece.places, atol=1e-5)
    document = json.loads(path.read_bytes()[20 : 20 + int.from_bytes(path.read_bytes()[12:16], "little")])
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])


def test_without_pictures_vertex_colours_are_used(example: SolvedExample) -> None:
    mesh = fused(example.solved)
    (piece,) = textured(example.solved.stations, example.solved.calibration, mesh)
    assert not piece.jpeg
    assert len(piece.mesh.triangles) == len(mesh.triangles)


def test_different_lighting_is_equalised() -> None:
    rng = np.random.default_rng(0)
    paint = rng.uniform(60, 140, (96, 128))
    light = np.linspace(0.6, 1.5, 128) * np.linspace(1.1, 0.9, 96)[:, None]
    y, x = (each.ravel().astype(np.float64) for each in np.mgrid[0:96, 0:128])
    seen = x > 30
    shown = [
        PointsInPicture(np.rint(each).astype(np.uint8)[..., None].repeat(3, axis=2), np.stack([x, y], axis=1), there)
        for each, there in ((paint, seen), (paint * light, np.ones_like(seen)))
    ]
    one, other = (picture[..., 0].astype(np.float64) for picture in in_common_light(shown))
    both = seen.reshape(96, 128)
    ratio = other[both] / one[both]
    assert 0.97 < np.median(ratio) < 1.03
    assert 0.002 < np.std(ratio) < 0.04
    assert np.std((paint * light / paint)[both]) > 0.15
    assert in_common_light([]) == []


def test_denoising_brings_points_closer_to_their_planes(example: SolvedExample) -> None:
    for station, true in zip(example.solved.stations, example.true, strict=True):
        raw, smooth = (
            points.reshape(-1, 3)[true.pixel] for points in (station.cloud.points, denoised(example.solved, station))
        )
        there = np.isfinite(raw[:, 2]) & (station.plane.reshape(-1)[true.pixel] >= 0)
        before, after = (np.linalg.norm((points - true.points)[there], axis=1) for points in (raw, smooth))
        assert 0.05 < np.median(after) / np.median(before) < 0.7
        assert np.percentile(after, 95) < np.percentile(before, 95)
        elsewhere = np.isfinite(raw[:, 2]) & ~there
        assert np.array_equal(raw[elsewhere], smooth[elsewhere])


def test_denoising_keeps_a_step(example: SolvedExample) -> None:
    station = example.solved.stations[0]
    plane = int(np.bincount(station.plane[station.plane >= 0]).argmax())
    on = (station.plane == plane) & station.cloud.there
    column = np.arange(on.shape[1])[None, :]
    nearer = on & (column < np.median(np.flatnonzero(on.any(axis=0))))
    points = station.cloud.points.copy()
    points[nearer] *= 0.97
    stepped = replace(station, cloud=replace(station.cloud, points=points))
    plain, kept = (denoised(example.solved, each)[..., 2] for each in (station, stepped))
    ratio = (kept / plain)[nearer]
    assert np.percentile(np.abs(ratio - 0.97), 98) < 0.003
    assert np.percentile(np.abs((kept / plain)[on & ~nearer] - 1), 98) < 0.003
