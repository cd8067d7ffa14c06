"""Tracks of keypoints through stations, and where the stations are, from the motions between pairs of them."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats, Ints
from calib.scene.rigid_scene import SceneObservations
from calib.scene.start import SceneStart, triangulated
from calib.scene.views import SceneView


def placed_stations(motions: Mapping[tuple[int, int], tuple[Pose, float]], count: int) -> dict[int, Pose]:
    """Stations that motions X_i = R X_j + t connect with the most others, X_station = R X_root + t.

    A maximum spanning tree by the worth of the motions (Kruskal).
    """
    group = {k: {k: IDENTITY} for k in range(count)}
    for (i, j), (pose, _) in sorted(motions.items(), key=lambda motion: -motion[1][1]):
        first, second = group[i], group[j]
        if first is second:
            continue
        # X_i = pose X_j, X_i = first[i] X_a, X_j = second[j] X_b, so that X_b = second[j]⁻¹ pose⁻¹ first[i] X_a.
        bridge = second[j].inverse() @ pose.inverse() @ first[i]
        first |= {k: place @ bridge for k, place in second.items()}
        for k in second:
            group[k] = first
    largest = max(group.values(), key=len)
    root = largest[min(largest)].inverse()
    return {k: largest[k] @ root for k in sorted(largest)}


def observe(
    start: SceneStart,
    views: Sequence[SceneView],
    pairs: Mapping[tuple[int, int], tuple[Ints, Ints]],
    places: Mapping[int, Pose],
) -> tuple[SceneObservations, Floats]:
    """Observations of keypoints that agree between placed stations, and their points (N, 3) in the first one's frame.

    `station` numbers the placed stations in their order. A track that has two keypoints of one station is left out.
    """
    offsets = np.cumsum([0, *map(len, views)])
    from_keypoints, to_keypoints = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for (i, j), (_, near) in start.motions.items():
        if i in places and j in places:
            own, matching = pairs[i, j]
            from_keypoints.append(offsets[i] + own[near])
            to_keypoints.append(offsets[j] + matching[near])
    rows, columns = np.concatenate(from_keypoints), np.concatenate(to_keypoints)
    links = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), (offsets[-1], offsets[-1]))
    _, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    keypoint = np.unique(np.concatenate([rows, columns]))
    station_of = np.searchsorted(offsets, keypoint, side="right") - 1
    track = label[keypoint]
    _, number, size = np.unique(track, return_inverse=True, return_counts=True)
    visits, keypoints_of_visit = np.unique(np.stack([track, station_of]), axis=1, return_counts=True)
    kept = (size[number] > 1) & ~np.isin(track, visits[0][keypoints_of_visit > 1])
    keypoint, station_of = keypoint[kept], station_of[kept]
    _, point = np.unique(track[kept], return_inverse=True)
    by_point = np.argsort(point, kind="stable")
    keypoint, station_of, point = keypoint[by_point], station_of[by_point], point[by_point]
    order = {k: n for n, k in enumerate(places)}

    observations = SceneObservations(
        point.astype(np.int64),
        np.array([order[k] for k in station_of.tolist()], np.int64),
        np.concatenate([view.camera_px for view in views])[keypoint],
        np.concatenate([view.projector_px for view in views])[keypoint],
        np.concatenate([view.slope for view in views])[keypoint],
        np.concatenate([view.sigma_px for view in views])[keypoint],
        np.ones(len(keypoint)),
    )
    own = np.concatenate([triangulated(start.rig, view) for view in views])[keypoint]
    back = Pose.stack([places[k].inverse() for k in station_of.tolist()])
    at_first = np.einsum("mij,mj->mi", back.rotation, own) + back.translation
    total, weight = np.zeros((int(point.max(initial=-1)) + 1, 3)), np.zeros(int(point.max(initial=-1)) + 1)
    known = np.isfinite(at_first[:, 2])
    np.add.at(total, point[known], at_first[known])
    np.add.at(weight, point[known], 1.0)
    return observations, total / np.maximum(weight, 1.0)[:, None]
