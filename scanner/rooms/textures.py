"""The room's triangles under the stations' pictures: each under that of the station which sees it largest.

Pictures are made as bright as each other where they overlap (common_light.py), so that they agree at their seams.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Intrinsics
from calib.numerics import Bools, Floats, Ints
from scanner.exporting import Mesh, Piece
from scanner.rooms.common_light import PointsInPicture, in_common_light
from scanner.rooms.contents import Station
from scanner.rooms.mesh import CAMERA_FROM_ROOM, filled

_EDGES = 2.0  # largest distance of a vertex from what a station measured there, in edges of the mesh
_STEP = 6.0  # the same within the neighbourhood of a pixel; larger depth steps make its texture uncertain
_LARGEST_PX, _JPEG_QUALITY = 2048, 90


def textured(stations: Sequence[Station], calibration: Calibration, mesh: Mesh) -> list[Piece]:
    """The mesh in pieces, one for each picture; what no picture shows has its vertices' colours."""
    points = mesh.points @ CAMERA_FROM_ROOM
    edges = points[mesh.triangles[:, 0]] - points[mesh.triangles[:, 1]]
    near = _EDGES * float(np.median(np.linalg.norm(edges, axis=1)))
    camera = calibration.camera
    pictured = [station for station in stations if station.decoded.texture is not None]
    shown = []
    owner, largest = np.full(len(mesh.triangles), -1), np.zeros(len(mesh.triangles))
    for number, station in enumerate(pictured):
        pixels, seen = _looked_at(station, points, camera, near)
        shown.append(PointsInPicture(_without_gaps(station.cloud.colours, station.cloud.there), pixels, seen))
        corners = pixels[mesh.triangles]
        one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
        larger = seen[mesh.triangles].all(axis=1) & (area > largest)
        owner[larger], largest[larger] = number, area[larger]
    pictures = in_common_light(shown)
    pieces = []
    for number in np.unique(owner).tolist():
        vertices, own = part_of(mesh, owner == number)
        if number < 0:
            pieces.append(Piece(own))
            continue
        places = (shown[number].pixels[vertices] + 0.5) / [camera.width, camera.height]
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
    low, high = (each[np.where(inside, row, 0), np.where(inside, column, 0)] for each in (nearest, farthest))
    with np.errstate(invalid="ignore"):
        seen: Bools = inside & (own[:, 2] > low - near) & (own[:, 2] < high + near) & (high - low < _STEP * near)
    return np.where(seen[:, None], pixels, 0.0), seen


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
