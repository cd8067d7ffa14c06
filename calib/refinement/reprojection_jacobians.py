"""From the pixels of one device to those of the other, by planes, with derivatives, compiled."""

import numpy as np

from calib.geometry import dot, project_into, unproject_into
from calib.numerics import Floats, Ints, compiled

_FACES, _PER_CORNER, _PER_POSE, _PER_PLANE = 3, 3, 6, 3


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
def reproject(
    devices: tuple[Floats, Floats],
    camera_px: Floats,
    plane: Ints,
    normals: Floats,
    heights: Floats,
    normals_by_angles: Floats,
    normals_by_tilts: Floats,
    vertex: Floats,
    rotation: Floats,
    translation: Floats,
    translation_by_columns: Floats,
    first: tuple[int, int, int],
) -> tuple[Floats, Floats, Floats]:
    """Pixels (N, 2) of the second of two `devices` (8,) where the first's `camera_px` (N, 2) meet their planes.

    Planes n · X = n · vertex + height are the faces 0, 1, 2 of a corner, and further ones from 3 on. Also returns the
    derivatives (N, 2, columns), and the depths before both devices (N, 2). `translation_by_columns`: (3, columns);
    `first`: the first column of the second device, of the rotation, and of the corner's angles, behind which are its
    rotation, its vertex (as a share of its distance) and, for each further plane, two tilts and the height.

    With rays r and Y = R X + t, dY = R dX + ω × R X + dt, and
    dX = depth (dr − r n·dr / n·r) + r / (n·r) (dn·(vertex − X) + n·dvertex + dheight)
    """
    count, of_device = len(camera_px), len(devices[0])
    rays, rays_by_camera = np.empty((count, 3)), np.zeros((count, 3, of_device))
    unproject_into(devices[0], camera_px, rays, rays_by_camera)
    depths, turned, moved = np.empty((count, 2)), np.empty((count, 3)), np.empty((count, 3))
    for i in range(count):
        if not 0 <= plane[i] < len(normals):
            raise IndexError("a match is on a plane that its capture does not have")
        normal = normals[plane[i]]
        depths[i, 0] = (dot(normal, vertex) + heights[plane[i]]) / dot(normal, rays[i])
        for k in range(3):
            turned[i, k] = depths[i, 0] * dot(rotation[k], rays[i])
            moved[i, k] = turned[i, k] + translation[k]
        depths[i, 1] = moved[i, 2]
    pixels, by_moved, by_projector = np.empty((count, 2)), np.empty((count, 2, 3)), np.zeros((count, 2, of_device))
    project_into(devices[1], moved, pixels, by_moved, by_projector)

    jacobian = np.empty((count, 2, translation_by_columns.shape[1]))
    distance, to_vertex, by_point = np.sqrt(dot(vertex, vertex)), np.empty(3), np.empty(3)
    of_device_2, of_rotation, of_angles = first
    of_pose = of_angles + _PER_CORNER
    for i in range(count):
        on, ray, turn, depth = plane[i], rays[i], turned[i], depths[i, 0]
        normal, facing = normals[on], dot(normals[on], rays[i])
        for k in range(3):
            to_vertex[k] = vertex[k] - depth * ray[k]
        for k in range(2):
            by, row = by_moved[i, k], jacobian[i, k]
            for c in range(len(row)):
                row[c] = (
                    by[0] * translation_by_columns[0, c]
                    + by[1] * translation_by_columns[1, c]
                    + by[2] * translation_by_columns[2, c]
                )
            for c in range(3):
                by_point[c] = by[0] * rotation[0, c] + by[1] * rotation[1, c] + by[2] * rotation[2, c]
            along = dot(by_point, ray) / facing
            by_x, by_y = depth * (by_point[0] - along * normal[0]), depth * (by_point[1] - along * normal[1])
            for c in range(of_device):
                row[c] += by_x * rays_by_camera[i, 0, c] + by_y * rays_by_camera[i, 1, c]
                row[of_device_2 + c] += by_projector[i, k, c]
            for c in range(3):
                second, third = (c + 1) % 3, (c + 2) % 3
                row[of_rotation + c] += by[third] * turn[second] - by[second] * turn[third]
                row[of_angles + c] += along * dot(normals_by_angles[on, c], to_vertex)
                row[of_pose + c] += along * (normal[second] * to_vertex[third] - normal[third] * to_vertex[second])
                row[of_pose + 3 + c] += along * normal[c] * distance
            if on >= _FACES:
                own = of_pose + _PER_POSE + _PER_PLANE * (on - _FACES)
                row[own] += along * dot(normals_by_tilts[on, 0], to_vertex)
                row[own + 1] += along * dot(normals_by_tilts[on, 1], to_vertex)
                row[own + 2] += along
    return pixels, jacobian, depths
