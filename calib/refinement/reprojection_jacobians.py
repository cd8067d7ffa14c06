"""Compiled steps from a camera ray to a point in the second device's frame, with derivatives.

Each step takes N points at once, on the faces 0, 1, 2 of a corner or on further planes, 3 and up.
"""

import numpy as np

from calib.numerics import Floats, Ints, compiled

_FACES, _PER_POSE, _PER_PLANE = 3, 6, 3


@compiled
def face_normals(off_square: Floats, frame: Floats) -> tuple[Floats, Floats]:
    """Unit normals (3, 3) of a corner's faces in the camera's frame, and derivatives (3, 3 angles, 3) by its angles.

    In the corner's frame they are the rows of a symmetric matrix, scaled to unit length. Its diagonal is one; entry
    (i, j) is half the angle by which faces i and j are off square. The angle has the number of the third face.
    """
    normals, by_angles = np.empty((3, 3)), np.zeros((3, 3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        to_j, to_k = off_square[k] / 2, off_square[j] / 2
        length = np.sqrt(1 + to_j * to_j + to_k * to_k)
        for c in range(3):
            normals[i, c] = (frame[i, c] + to_j * frame[j, c] + to_k * frame[k, c]) / length
        for c in range(3):
            by_angles[i, k, c] = (frame[j, c] - to_j / length * normals[i, c]) / (2 * length)
            by_angles[i, j, c] = (frame[k, c] - to_k / length * normals[i, c]) / (2 * length)
    return normals, by_angles


@compiled
def meet(
    rays: Floats,
    rays_by_camera: Floats,
    plane: Ints,
    normals: Floats,
    heights: Floats,
    normals_by_angles: Floats,
    normals_by_tilts: Floats,
    vertex: Floats,
    by_camera: Floats,
    by_angles: Floats,
    by_pose: Floats,
) -> tuple[Floats, Floats]:
    """Points (N, 3) where rays r meet their planes n · X = n · vertex + height, in the camera's frame; depths (N,).

    dX = depth (dr − r n·dr / n·r) + r / (n·r) (dn·(vertex − X) + n·dvertex + dheight)

    Fills in the (zero-initialised) derivatives by the camera (8), the corner's angles (3), its rotation (3) and vertex
    (3, as a share of its distance) and, for each further plane, two tilts and the height.
    """
    points, depths = np.empty((len(rays), 3)), np.empty(len(rays))
    distance = np.sqrt(_dot(vertex, vertex))
    to_vertex, along = np.empty(3), np.empty(3)
    for i in range(len(rays)):
        on = plane[i]
        if not 0 <= on < len(normals):
            raise IndexError("a match is on a plane that its capture does not have")
        normal = normals[on]
        facing = _dot(normal, rays[i])
        depths[i] = (_dot(normal, vertex) + heights[on]) / facing
        for k in range(3):
            points[i, k] = depths[i] * rays[i, k]
            to_vertex[k] = vertex[k] - points[i, k]
            along[k] = rays[i, k] / facing

        for c in range(by_camera.shape[2]):
            back = _dot(normal, rays_by_camera[i, :, c])
            for k in range(3):
                by_camera[i, k, c] = depths[i] * (rays_by_camera[i, k, c] - along[k] * back)
        for c in range(3):
            second, third = (c + 1) % 3, (c + 2) % 3
            turned = normal[second] * to_vertex[third] - normal[third] * to_vertex[second]  # (n × (vertex − X))_c
            for k in range(3):
                by_angles[i, k, c] = along[k] * _dot(normals_by_angles[on, c], to_vertex)
                by_pose[i, k, c] = along[k] * turned
                by_pose[i, k, 3 + c] = along[k] * normal[c] * distance
        if on >= _FACES:
            own = _PER_POSE + _PER_PLANE * (on - _FACES)
            for k in range(3):
                by_pose[i, k, own] = along[k] * _dot(normals_by_tilts[on, 0], to_vertex)
                by_pose[i, k, own + 1] = along[k] * _dot(normals_by_tilts[on, 1], to_vertex)
                by_pose[i, k, own + 2] = along[k]
    return points, depths


@compiled
def move(
    points: Floats,
    points_by_columns: Floats,
    rotation: Floats,
    translation: Floats,
    translation_by_columns: Floats,
    first: int,
) -> tuple[Floats, Floats]:
    """R X + t (N, 3) with derivatives R dX + ω × R X + dt, (N, 3, columns); `first`: the first column of ω."""
    moved, by_columns = np.empty_like(points), np.empty_like(points_by_columns)
    turned = np.empty(3)
    for i in range(len(points)):
        for k in range(3):
            turned[k] = _dot(rotation[k], points[i])
            moved[i, k] = turned[k] + translation[k]
            for c in range(by_columns.shape[2]):
                by_columns[i, k, c] = translation_by_columns[k, c] + (
                    rotation[k, 0] * points_by_columns[i, 0, c]
                    + rotation[k, 1] * points_by_columns[i, 1, c]
                    + rotation[k, 2] * points_by_columns[i, 2, c]
                )
        for c in range(3):
            second, third = (c + 1) % 3, (c + 2) % 3
            by_columns[i, second, first + c] -= turned[third]
            by_columns[i, third, first + c] += turned[second]
    return moved, by_columns


@compiled
def chain(by_point: Floats, point_by_columns: Floats, by_device: Floats, first: int) -> Floats:
    """A pixel's derivatives by the point (N, 2, 3) times the point's (N, 3, columns) → (N, 2, columns).

    Those by the device itself (N, 2, 8) are added from column `first` on.
    """
    by_columns = np.empty((len(by_point), 2, point_by_columns.shape[2]))
    for i in range(len(by_point)):
        for k in range(2):
            for c in range(by_columns.shape[2]):
                by_columns[i, k, c] = (
                    by_point[i, k, 0] * point_by_columns[i, 0, c]
                    + by_point[i, k, 1] * point_by_columns[i, 1, c]
                    + by_point[i, k, 2] * point_by_columns[i, 2, c]
                )
            for c in range(by_device.shape[2]):
                by_columns[i, k, first + c] += by_device[i, k, c]
    return by_columns


@compiled
def _dot(a: Floats, b: Floats) -> float:
    dot: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return dot
