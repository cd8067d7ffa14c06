"""Segments of a cloud that are one plane each, by a criterion without calibration: a plane's matches follow a
homography.

With an approximate rig, a segment may contain nearly coplanar surfaces, such as two cupboards side by side. Matches
that a homography with lens distortion does not explain are removed; they form another plane if there are enough.
"""

from dataclasses import replace

import numpy as np

from calib.estimation import follow_one_plane
from calib.geometry import Calibration, Intrinsics, Matches, Plane, TooFewMatchesError
from calib.numerics import Bools, Ints, evenly
from calib.registration.range_view import StationView
from calib.registration.segments import NO_PLANE

_LEAST_MATCHES, _LEAST_SHARE = 200, 0.02  # share of a station's matches on planes
_MOST_PIECES = 3
_LEAST_OFF_PX = 0.1  # projector pixels left by an approximate lens
_FITTED = 4000


def split_planes(view: StationView, matches: Matches, calibration: Calibration) -> tuple[StationView, Ints]:
    """The view with straight planes, and the plane of each match (N,), −1 for none.

    `calibration`: an approximate rig; only its lens distortion is used.
    """
    ideal, known = _undistorted(matches, calibration)
    height, width = view.labels.shape
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixel = np.where(inside, row * width + column, 0)
    plane = np.where(inside & known, view.labels.ravel()[pixel], NO_PLANE)
    straight = np.full(len(matches), NO_PLANE, np.int32)
    fewest = max(_LEAST_MATCHES, int(_LEAST_SHARE * np.count_nonzero(plane != NO_PLANE)))
    count = 0
    for label in range(len(view.planes)):
        remaining = np.flatnonzero(plane == label)
        least = min(fewest, max(_LEAST_MATCHES, len(remaining) // 2))  # the segment may be small
        for _ in range(_MOST_PIECES):
            if len(remaining) < least:
                break
            try:
                on = follow_one_plane(ideal[remaining], _LEAST_OFF_PX)
            except TooFewMatchesError:
                break
            if np.count_nonzero(on) >= least:
                straight[remaining[on]] = count
                count += 1
            remaining, least = remaining[~on], fewest
    labels = np.full(height * width, NO_PLANE, np.int32)
    there = inside & (straight != NO_PLANE)
    labels[pixel[there]] = straight[there]
    labels[~np.isfinite(view.points[..., 2]).ravel()] = NO_PLANE
    return _with_labels(view, labels.reshape(height, width), straight, count)


def _undistorted(matches: Matches, calibration: Calibration) -> tuple[Matches, Bools]:
    """The same matches in devices of the same focal lengths without distortion, and which of them (N,) have a place."""
    camera_px, projector_px = (
        Intrinsics(device.width, device.height, device.focal_px, device.principal_point_px).project(
            device.unproject(pixels.astype(np.float64))
        )
        for device, pixels in ((calibration.camera, matches.camera_px), (calibration.projector, matches.projector_px))
    )
    known: Bools = np.asarray(np.isfinite(np.hstack([camera_px, projector_px])).all(axis=1), np.bool_)
    camera_px[~known], projector_px[~known] = 0.0, 0.0
    return Matches(camera_px, projector_px, None, matches.sigma_px), known


def _with_labels(view: StationView, labels: Ints, straight: Ints, count: int) -> tuple[StationView, Ints]:
    """With planes through the points of each label; labels without points are left out."""
    planes: list[Plane] = []
    renumbered = np.full(count + 1, NO_PLANE, np.int32)
    flat = view.points.reshape(-1, 3)
    for label in range(count):
        own = evenly(labels.ravel() == label, _FITTED)
        if len(own) < 3:
            continue
        renumbered[label] = len(planes)
        points = flat[own].astype(np.float64)
        planes.append(Plane.through(points, 1 / points[:, 2] ** 2))
    return replace(view, labels=renumbered[labels], planes=tuple(planes)), renumbered[straight]
