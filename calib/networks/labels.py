"""Which plane of the room a match is on, as its neighbours of other pairs tell it.

A projector's pixel lights one point, whichever camera sees it, and a camera's pixel sees one point, whichever projector
lights it.
"""

import numpy as np
from scipy.spatial import cKDTree

from calib.geometry import NO_FACE, Matches
from calib.numerics import Floats, Ints

_NEIGHBOURS = 4
_WITHIN = 3.0  # typical distances between neighbours: further away nothing is told
_ASIDE = 0.75  # of neighbours' mean distance: their mean is further away where all are on one side
_SAMPLE = 5_000


def labels_across(pixels: Floats, known_px: Floats, known: Ints) -> Ints:
    """Labels (N,) of a device's pixels (N, 2) from those of others of its pixels (M, 2), which have labels (M,).

    Neighbours on different sides of an edge agree on nothing: NO_FACE, as where there are none near, or all of them lie
    on one side, beyond what the others see of that plane.
    """
    if len(known_px) <= _NEIGHBOURS:
        return np.full(len(pixels), NO_FACE, np.int32)
    tree = cKDTree(known_px)
    some = known_px[:: max(1, len(known_px) // _SAMPLE)]
    typical = float(np.median(_nearest(tree, some, 2)[0][:, 1]))
    distance, nearest = _nearest(tree, pixels, _NEIGHBOURS)
    around = known[nearest]
    aside = np.linalg.norm((known_px[nearest] - pixels[:, None]).mean(axis=1), axis=1)
    agreed = (around == around[:, :1]).all(axis=1) & (distance[:, -1] <= _WITHIN * max(typical, 1.0))
    agreed &= aside <= _ASIDE * distance.mean(axis=1)
    labels: Ints = np.where(agreed, around[:, 0], NO_FACE).astype(np.int32)
    return labels


def _nearest(tree: "cKDTree[None]", pixels: Floats, count: int) -> tuple[Floats, Ints]:
    """Distances and indices (N, count) of the nearest pixels."""
    distance, nearest = tree.query(pixels, k=count)
    return np.asarray(distance), np.asarray(nearest)


def with_labels(matches: Matches, by_camera: list[Matches], by_projector: list[Matches]) -> Matches:
    """Matches with what others' labels tell of those without: of the same camera, and of the same projector."""
    label = np.full(len(matches), NO_FACE, np.int32) if matches.face is None else matches.face.copy()
    for others, axis in ((by_camera, "camera_px"), (by_projector, "projector_px")):
        for other in others:
            unlabelled = np.flatnonzero(label == NO_FACE)
            label[unlabelled] = labels_across(getattr(matches, axis)[unlabelled], getattr(other, axis), other.labels)
    return matches.with_faces(label)
