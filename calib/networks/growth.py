"""Devices that are not placed yet, from the light that they share with placed ones.

Which plane of the room a match is on is told by its neighbours: a projector's pixel lights one point, whichever camera
sees it, and a camera's pixel sees one point, whichever projector lights it. A device all of whose matches have labels
sees known points: its start is the direct linear transform (Hartley & Zisserman, section 7.1), and the joint estimate
takes it from there.
"""

import numpy as np
from scipy.spatial import cKDTree

from calib.closed_form import decompose
from calib.geometry import NO_FACE, Matches, Motion, homogeneous, normalisation
from calib.networks.network import Device
from calib.numerics import Floats, Ints

_NEIGHBOURS = 4
_WITHIN = 3.0  # typical distances between neighbours: further away nothing is told
_SAMPLE = 5_000
_TOLD = 1e-9  # of the largest eigenvalue: less, and points on one plane leave the device open


def labels_across(pixels: Floats, known_px: Floats, known: Ints) -> Ints:
    """Labels (N,) of a device's pixels (N, 2) from those of others of its pixels (M, 2), which have labels (M,).

    All neighbours on different sides of an edge agree on nothing: NO_FACE, as where there are none near.
    """
    if len(known_px) <= _NEIGHBOURS:
        return np.full(len(pixels), NO_FACE, np.int32)
    tree = cKDTree(known_px)
    some = known_px[:: max(1, len(known_px) // _SAMPLE)]
    typical = float(np.median(_nearest(tree, some, 2)[0][:, 1]))
    distance, nearest = _nearest(tree, pixels, _NEIGHBOURS)
    around = known[nearest]
    agreed = (around == around[:, :1]).all(axis=1) & (distance[:, -1] <= _WITHIN * max(typical, 1.0))
    labels: Ints = np.where(agreed, around[:, 0], NO_FACE).astype(np.int32)
    return labels


def _nearest(tree: "cKDTree[None]", pixels: Floats, count: int) -> tuple[Floats, Ints]:
    """Distances and indices (N, count) of the nearest pixels."""
    distance, nearest = tree.query(pixels, k=count)
    return np.asarray(distance), np.asarray(nearest)


def with_labels(matches: Matches, by_camera: list[Matches], by_projector: list[Matches]) -> Matches:
    """Matches with what others' labels tell of them: of the same camera, and of the same projector."""
    label = np.full(len(matches), NO_FACE, np.int32)
    for others, axis in ((by_camera, "camera_px"), (by_projector, "projector_px")):
        for other in others:
            told = labels_across(getattr(matches, axis), getattr(other, axis), other.labels)
            label = np.where(label == NO_FACE, told, label)
    return matches.with_faces(label)


def placed(points: Floats, pixels: Floats) -> Device | None:
    """A device, without lens terms, that sees points (N, 3) at pixels (N, 2); None of points on one plane."""
    scale, centre = normalisation(pixels), points.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))
    ideal = homogeneous(pixels) @ scale.T
    solid = homogeneous((points - centre) / spread)
    rows = np.zeros((2 * len(points), 12))
    rows[0::2, 0:4], rows[0::2, 8:12] = solid, -ideal[:, :1] * solid
    rows[1::2, 4:8], rows[1::2, 8:12] = solid, -ideal[:, 1:2] * solid
    values, vectors = np.linalg.eigh(rows.T @ rows)
    if values[1] < _TOLD * values[-1]:
        return None
    motion = np.linalg.inv(scale) @ vectors[:, 0].reshape(3, 4)
    matrix, rotation, translation = (each[0] for each in decompose(motion[None]))
    if not (np.isfinite(matrix).all() and np.isfinite(rotation).all()):
        return None
    lens = np.array([np.sqrt(matrix[0, 0] * matrix[1, 1]), *matrix[:2, 2], 0.0, 0.0, 0.0, 0.0, 0.0])
    back = rotation.T
    device = Device(lens, Motion(back, centre - spread * (back @ translation)))
    ahead = (points - device.pose.translation) @ back[:, 2]
    return device if np.median(ahead) > 0 else None
