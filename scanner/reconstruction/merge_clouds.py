"""Captures of one corner → one cloud in the corner's frame, where it is certain how they belong together."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Corner
from calib.numerics import Floats, Image
from calib.pointcloud import Cloud, MergedCloud, Order, View, find_order, merged
from scanner.results import Findings, Scan

# Corners whose angles differ by more than this were found to be different ones: shared angles are equal.
_SAME_ANGLE_DEG = 1e-6
_CONSISTENCY_SAMPLE = 20_000


def merge(scan: Scan) -> None:
    """Fill in the merged cloud of captures of one corner, and say how well they agree, or why there is none."""
    if not _one_corner(scan.captures):
        scan.remarks_on_merging = ("The captures do not show the same corner, so their clouds were not merged.",)
        return
    views = [_view(found) for found in scan.captures]
    newest = scan.newest.solution
    order = find_order(views, newest.order_nats if newest else 0.0)
    if not order.decided:
        scan.remarks_on_merging = (_why_not(order),)
        return
    clouds = [found.cloud for found in scan.captures if found.cloud is not None]
    scan.merged = merged(clouds, views, order.turns)
    scan.remarks_on_merging = (_how_well(clouds, views, scan.merged),)


def _one_corner(captures: Sequence[Findings]) -> bool:
    """The calibration shares the angles of captures unless their matches tell that they show different corners."""
    angles = np.array([found.solution.corner.angles_deg for found in captures if found.solution])
    return bool(np.ptp(angles, axis=0).max() < _SAME_ANGLE_DEG)


def _view(found: Findings) -> View:
    assert found.cloud is not None
    assert found.solution is not None
    assert found.calibration is not None
    corner = found.solution.corner  # in baselines
    return View(
        found.cloud.points,
        None if found.texture is None else brightness(found.texture),
        found.calibration.camera,
        Corner(corner.vertex * found.calibration.baseline, corner.legs),
    )


def brightness(texture: Image) -> NDArray[np.float32]:
    """Grey levels (H, W) of a picture, grey or in colour."""
    grey = cv2.cvtColor(texture, cv2.COLOR_BGR2GRAY) if texture.ndim == 3 else texture
    return grey.astype(np.float32)


def _why_not(order: Order) -> str:
    if order.contradictory:
        reason = "what stands before the faces in one capture is not there in the others"
    else:
        reason = "a square corner looks the same from three sides, and nothing that was seen tells them apart"
    return (
        f"The clouds were not merged: {reason}. The calibration does not depend on it; every capture has its own cloud."
    )


def _how_well(clouds: Sequence[Cloud], views: Sequence[View], cloud: MergedCloud) -> str:
    apart = consistency(clouds, views, cloud.turns)
    agreement = (
        f" Where several see the same surface, they agree to {100 * float(np.median(apart)):.2g} % of its distance "
        "(median)."
        if len(apart)
        else ""
    )
    unit = "baselines" if cloud.unit == "baseline" else cloud.unit
    return (
        f"The {len(clouds)} clouds are merged in the corner's frame: {len(cloud.points):,} points, at most one in each "
        f"cube of {cloud.grid:.2g} {unit}.{agreement}"
    )


def consistency(clouds: Sequence[Cloud], views: Sequence[View], turns: Sequence[int]) -> Floats:
    """Distances of points of each capture from the surface that another one saw there, relative to their own, (M,).

    Only where the other saw about the same depth: what hides behind something else says nothing.
    """
    apart = []
    for i, (cloud, view) in enumerate(zip(clouds, views, strict=True)):
        points = cloud.points[cloud.there].astype(np.float64)
        points = points[:: max(1, len(points) // _CONSISTENCY_SAMPLE)]
        for j, other in enumerate(views):
            if j != i:
                moved = other.in_camera(view.in_corner(points, turns[i]), turns[j])
                apart.append(_from_surface(clouds[j], other, moved))
    return np.concatenate(apart)


def _from_surface(cloud: Cloud, view: View, points: Floats) -> Floats:
    """Of points (N, 3) in a view's frame those that it saw, (M,): their distance along its normals, relative."""
    nearest, farthest, sees = view.depths_around(points)
    with np.errstate(invalid="ignore"):
        seen = points[sees & (nearest < 1.01 * points[:, 2]) & (farthest > 0.99 * points[:, 2])]
    column, row = np.rint(view.camera.project(seen)).astype(np.int64).T
    along = np.sum((seen - cloud.points[row, column]) * cloud.normals[row, column], axis=1)
    apart = np.abs(along) / np.linalg.norm(seen, axis=1)
    known: Floats = apart[np.isfinite(apart)]
    return known
