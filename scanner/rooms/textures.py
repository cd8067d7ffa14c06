"""The room's triangles under the stations' pictures: each under that of the station which sees it largest.

Pictures are made as bright as each other where they overlap, so that they agree at their seams. Each is multiplied by a
smooth field, whose logarithm is linear between the nodes of a coarse grid. Least squares over all points that two
pictures show equalises their logarithms (like exposures of panoramas: Brown and Lowe, "Automatic panoramic image
stitching using invariant features", 2007, but with a field for each picture).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, coo_array, csc_array
from scipy.sparse.linalg import spsolve

from calib.geometry import Calibration, Intrinsics
from calib.numerics import Bools, Floats, Ints, evenly
from scanner.exporting import Mesh, Piece
from scanner.rooms.contents import Station
from scanner.rooms.mesh import CAMERA_FROM_ROOM, filled

_NODES = 17  # nodes along a picture's longer side
_POINTS = 4000  # points per pair of pictures
_SMOOTH, _HELD = 1.0, 0.03  # weights of differences between neighbouring nodes, and of differences from no change
_DARK = 8.0  # of 255 levels; darker pixels carry little information
_BRIGHTEST = 0.98  # quantile of the light that stays below white
_FARTHEST = 1.5  # largest difference of logarithms; pictures that differ more do not show the same
_EDGES = 2.0  # largest distance of a vertex from what a station measured there, in edges of the mesh
_STEP = 6.0  # the same within the neighbourhood of a pixel; larger depth steps make its texture uncertain
_LARGEST_PX, _JPEG_QUALITY = 2048, 90


@dataclass(frozen=True, eq=False)
class PointsInPicture:
    """A `picture` (H, W, 3), and at which of its `pixels` (N, 2) each point is, of those that it has `seen` (N,)."""

    picture: NDArray[np.uint8]
    pixels: Floats
    seen: Bools


def in_common_light(photographs: Sequence[PointsInPicture]) -> list[NDArray[np.uint8]]:
    """The pictures (H, W, 3), brighter and darker, not beyond white; the points and the sizes are the same in all."""
    if not photographs:
        return []
    height, width = photographs[0].picture.shape[:2]
    step = max(height, width) / (_NODES - 1)
    nodes = int(np.ceil(height / step)) + 1, int(np.ceil(width / step)) + 1
    fields = _fields(photographs, step, nodes)
    fields -= max(
        [
            0.0,
            *(
                _above_white(*photograph_and_field, step, nodes)
                for photograph_and_field in zip(photographs, fields, strict=True)
                if photograph_and_field[0].seen.any()
            ),
        ]
    )
    row, column = (np.arange(size, dtype=np.float32) / np.float32(step) for size in (height, width))
    across, down = np.meshgrid(column, row)
    pictures = []
    for photograph, field in zip(photographs, fields, strict=True):
        gain = np.exp(cv2.remap(field.astype(np.float32), across, down, cv2.INTER_LINEAR))
        pictures.append(np.asarray(np.clip(np.rint(photograph.picture * gain[..., None]), 0, 255), np.uint8))
    return pictures


def _fields(photographs: Sequence[PointsInPicture], step: float, nodes: tuple[int, int]) -> Floats:
    """Logarithms of the gains at the nodes, (pictures, rows, columns)."""
    size = nodes[0] * nodes[1]
    rows, columns, values, right = [], [], [], []
    count = 0
    for (a, first), (b, second) in combinations(enumerate(photographs), 2):
        both = evenly(first.seen & second.seen, _POINTS)
        off = np.log(_light(second, both)) - np.log(_light(first, both))
        both, off = both[np.abs(off) < _FARTHEST], off[np.abs(off) < _FARTHEST]
        equation = np.repeat(count + np.arange(len(both)), 4)
        for number, photograph, sign in ((a, first, 1.0), (b, second, -1.0)):
            node, weight = _between(photograph.pixels[both], step, nodes)
            rows.append(equation)
            columns.append(number * size + node.ravel())
            values.append(sign * weight.ravel())
        right.append(off)
        count += len(both)
    of_points = coo_array(
        (np.concatenate([*values, []]), (np.concatenate([*rows, []]), np.concatenate([*columns, []]))),
        (count, size * len(photographs)),
    ).tocsc()
    held = csc_array(_HELD**2 * np.eye(size) + _SMOOTH**2 * _roughness(nodes))
    normal = of_points.T @ of_points + block_diag([held] * len(photographs), format="csc")
    fields: Floats = spsolve(csc_array(normal), of_points.T @ np.concatenate([*right, []]))
    return fields.reshape(len(photographs), *nodes)


def _above_white(photograph: PointsInPicture, field: Floats, step: float, nodes: tuple[int, int]) -> float:
    """By how much the logarithm of its brightest seen points exceeds white after the gains (rows, columns)."""
    lit = np.flatnonzero(photograph.seen)
    node, weight = _between(photograph.pixels[lit], step, nodes)
    light = np.log(_light(photograph, lit)) + np.sum(field.ravel()[node] * weight, axis=1)
    return float(np.quantile(light, _BRIGHTEST) - np.log(255.0))


def _light(photograph: PointsInPicture, some: Ints) -> Floats:
    column, row = np.rint(photograph.pixels[some]).astype(np.int64).T
    light: Floats = photograph.picture[row, column].astype(np.float64).mean(axis=1) + _DARK
    return light


def _between(pixels: Floats, step: float, nodes: tuple[int, int]) -> tuple[Ints, Floats]:
    """The four nodes around pixels (N, 2), and how much of each, (N, 4)."""
    at = pixels / step
    low = np.minimum(at.astype(np.int64), np.array(nodes[::-1]) - 2)
    (x, y), (i, j) = (at - low).T, low.T
    node = np.stack([j * nodes[1] + i, j * nodes[1] + i + 1, (j + 1) * nodes[1] + i, (j + 1) * nodes[1] + i + 1], 1)
    return node, np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1)


def _roughness(nodes: tuple[int, int]) -> Floats:
    """The sum of squared differences of neighbouring nodes, as a matrix."""
    number = np.arange(nodes[0] * nodes[1]).reshape(nodes)
    pairs = np.concatenate(
        [
            np.stack([number[:, 1:].ravel(), number[:, :-1].ravel()], axis=1),
            np.stack([number[1:].ravel(), number[:-1].ravel()], axis=1),
        ]
    )
    difference = np.zeros((len(pairs), number.size))
    difference[np.arange(len(pairs)), pairs[:, 0]] = 1.0
    difference[np.arange(len(pairs)), pairs[:, 1]] = -1.0
    return difference.T @ difference


def textured(stations: Sequence[Station], calibration: Calibration, mesh: Mesh) -> list[Piece]:
    """The mesh in pieces, one for each picture; what no picture shows has its vertices' colours."""
    points = mesh.points @ CAMERA_FROM_ROOM
    edges = points[mesh.triangles[:, 0]] - points[mesh.triangles[:, 1]]
    near = _EDGES * float(np.median(np.linalg.norm(edges, axis=1)))
    camera = calibration.camera
    pictured = [station for station in stations if station.decoded.texture is not None]
    station_pixels = []
    owner, largest = np.full(len(mesh.triangles), -1), np.zeros(len(mesh.triangles))
    for number, station in enumerate(pictured):
        pixels, visible = _looked_at(station, points, camera, near)
        station_pixels.append(
            PointsInPicture(_without_gaps(station.cloud.colours, station.cloud.there), pixels, visible)
        )
        corners = pixels[mesh.triangles]
        first_edge, second_edge = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.abs(first_edge[:, 0] * second_edge[:, 1] - first_edge[:, 1] * second_edge[:, 0])
        larger = visible[mesh.triangles].all(axis=1) & (area > largest)
        owner[larger], largest[larger] = number, area[larger]
    pictures = in_common_light(station_pixels)
    pieces = []
    for number in np.unique(owner).tolist():
        vertices, own = part_of(mesh, owner == number)
        if number < 0:
            pieces.append(Piece(own))
            continue
        places = (station_pixels[number].pixels[vertices] + 0.5) / [camera.width, camera.height]
        pieces.append(Piece(own, places, _encoded(pictures[number])))
    return pieces


def part_of(mesh: Mesh, chosen: Bools) -> tuple[Ints, Mesh]:
    """Some triangles (T,) with their vertices, and which of the mesh's these are."""
    vertices, corners = np.unique(mesh.triangles[chosen], return_inverse=True)
    triangles = corners.reshape(-1, 3).astype(np.int64)
    return vertices, Mesh(mesh.points[vertices], mesh.normals[vertices], mesh.colours[vertices], triangles, mesh.unit)


def _looked_at(station: Station, points: Floats, camera: Intrinsics, near: float) -> tuple[Floats, Bools]:
    """The station's camera pixels (N, 2) of points (N, 3) of the room, and which of them (N,) it sees."""
    own = station.place.undo(points)
    ahead = own[:, 2] > 0
    pixels = camera.project(np.where(ahead[:, None], own, [0.0, 0.0, 1.0]))
    depth = filled(np.where(station.cloud.there, station.cloud.points[..., 2], np.nan))
    square = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(np.where(depth > 0, depth, np.inf), square), cv2.dilate(depth, square)
    height, width = depth.shape
    outside = np.array([width, height], np.float64)
    column, row = np.rint(np.clip(np.where(np.isfinite(pixels), pixels, -1.0), -1.0, outside)).astype(np.int64).T
    inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    low, high = (bound[np.where(inside, row, 0), np.where(inside, column, 0)] for bound in (nearest, farthest))
    with np.errstate(invalid="ignore"):
        visible: Bools = inside & (own[:, 2] > low - near) & (own[:, 2] < high + near) & (high - low < _STEP * near)
    return np.where(visible[:, None], pixels, 0.0), visible


def _without_gaps(colours: NDArray[np.uint8], there: Bools) -> NDArray[np.uint8]:
    """Pixels (H, W) without a point have the colour of the nearest one that has one."""
    gaps = (~there).astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(gaps, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    colour_of = np.zeros((int(label.max()) + 1, 3), np.uint8)
    colour_of[label[there]] = colours[there]
    nearest: NDArray[np.uint8] = colour_of[label]
    return nearest


def _encoded(picture: NDArray[np.uint8]) -> bytes:
    """As JPEG, no larger than viewers take it."""
    scale = min(1.0, _LARGEST_PX / max(picture.shape[:2]))
    if scale < 1.0:
        picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    _, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()
