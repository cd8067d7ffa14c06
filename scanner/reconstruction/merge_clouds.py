"""Captures of one corner → one cloud in the frame of the corner, if their relation is certain."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.finding import Datum, Finding, FindingKind, Severity
from calib.numerics import Bools, Floats, Image
from calib.pointcloud import Cloud, CornerView, MergedCloud, Order, find_order, merged
from scanner.results import SelfCalibrated

# Corners whose angles differ by more than this are different ones.
_SAME_ANGLE_DEG = 1e-6
_CONSISTENCY_SAMPLE = 20_000

MERGED = FindingKind(
    "merged",
    "The clouds of several captures of one corner are merged in its frame.",
    data=("points", "apart_share"),
)
NOT_MERGED = FindingKind(
    "not-merged",
    "The relation of several captures is not certain, so their clouds were not merged. The calibration does not depend "
    "on it.",
    "Put something into the corner that makes its sides different, and let nothing in it move between captures.",
)


def merge(captures: Sequence[SelfCalibrated], clouds: Sequence[Cloud]) -> tuple[MergedCloud | None, Finding]:
    """The merged cloud of captures of one corner, and their agreement; or None, and the reason."""
    if not _one_corner(captures):
        message = "The captures do not show the same corner, so their clouds were not merged."
        return None, Finding(NOT_MERGED, Severity.NOTE, message)
    views = [_view(capture, cloud) for capture, cloud in zip(captures, clouds, strict=True)]
    order = find_order(views, captures[-1].solution.order_nats)
    if not order.decided:
        return None, _why_not(order)
    cloud = merged(clouds, views, order.turns)
    return cloud, _agreement(clouds, views, cloud)


def overlap(captures: Sequence[SelfCalibrated], clouds: Sequence[Cloud]) -> float | None:
    """Share of the newest capture that an earlier one saw as well; None if the relation of captures is uncertain."""
    if not _one_corner(captures):
        return None
    views = [_view(capture, cloud) for capture, cloud in zip(captures, clouds, strict=True)]
    order = find_order(views, captures[-1].solution.order_nats)
    if not order.decided:
        return None
    points = _sample(clouds[-1])
    visible = np.zeros(len(points), bool)
    for view, turn in zip(views[:-1], order.turns, strict=False):
        moved = view.in_camera(views[-1].in_corner(points, order.turns[-1]), turn)
        visible |= _sees(view, moved)
    return float(np.mean(visible)) if len(visible) else 0.0


def _one_corner(captures: Sequence[SelfCalibrated]) -> bool:
    """Whether the calibration shares the angles of captures, because their matches show the same corner."""
    angles = np.array([capture.solution.corner.angles_deg for capture in captures])
    return bool(np.ptp(angles, axis=0).max() < _SAME_ANGLE_DEG)


def _view(capture: SelfCalibrated, cloud: Cloud) -> CornerView:
    texture = capture.decoded.texture
    light = None if texture is None else brightness(texture)
    return CornerView(cloud.points, light, capture.calibration.camera, capture.corner)


def brightness(texture: Image) -> NDArray[np.float32]:
    """Grey levels (H, W) of a picture, grey or in colour."""
    grey = cv2.cvtColor(texture, cv2.COLOR_BGR2GRAY) if texture.ndim == 3 else texture
    return grey.astype(np.float32)


def _why_not(order: Order) -> Finding:
    if order.contradictory:
        reason = "what stands before the faces differs between the captures"
    else:
        reason = "a square corner looks the same from three sides, and nothing in the captures distinguishes them"
    return Finding(
        NOT_MERGED,
        Severity.NOTE,
        f"The clouds were not merged: {reason}. The calibration does not depend on it; every capture has its own "
        "cloud.",
    )


def _agreement(clouds: Sequence[Cloud], views: Sequence[CornerView], cloud: MergedCloud) -> Finding:
    apart = consistency(clouds, views, cloud.turns)
    agreement, data = "", dict[str, Datum](points=float(len(cloud.points)))
    if len(apart):
        share = float(np.median(apart))
        agreement = f" Where they overlap, they agree to {100 * share:.2g} % of the distance (median)."
        data["apart_share"] = share
    unit = "baselines" if cloud.unit == "baseline" else cloud.unit
    return Finding(
        MERGED,
        Severity.NOTE,
        f"The {len(clouds)} clouds are merged in the corner's frame: {len(cloud.points):,} points, at most one in each "
        f"cube of {cloud.grid:.2g} {unit}.{agreement}",
        data=data,
    )


def consistency(clouds: Sequence[Cloud], views: Sequence[CornerView], turns: Sequence[int]) -> Floats:
    """Distances of points of each capture from the surface of another one there, relative to their depth, (M,).

    Only points where the other saw about the same depth count, because others may be hidden.
    """
    apart = []
    for i, (cloud, view) in enumerate(zip(clouds, views, strict=True)):
        points = _sample(cloud)
        for j, target in enumerate(views):
            if j != i:
                moved = target.in_camera(view.in_corner(points, turns[i]), turns[j])
                apart.append(_from_surface(clouds[j], target, moved))
    return np.concatenate(apart)


def _sample(cloud: Cloud) -> Floats:
    points: Floats = cloud.points[cloud.there].astype(np.float64)
    return points[:: max(1, len(points) // _CONSISTENCY_SAMPLE)]


def _sees(view: CornerView, points: Floats) -> Bools:
    """Which points (N, 3) of its frame a view saw, (N,), and nothing before or behind them."""
    nearest, farthest, sees = view.depths_around(points)
    with np.errstate(invalid="ignore"):
        visible: Bools = sees & (nearest < 1.01 * points[:, 2]) & (farthest > 0.99 * points[:, 2])
    return visible


def _from_surface(cloud: Cloud, view: CornerView, points: Floats) -> Floats:
    """Select the points (N, 3) in a view's frame that the view saw. Return their relative distance along its normals,
    (M,).
    """
    visible = points[_sees(view, points)]
    column, row = np.rint(view.camera.project(visible)).astype(np.int64).T
    along = np.sum((visible - cloud.points[row, column]) * cloud.normals[row, column], axis=1)
    apart = np.abs(along) / np.linalg.norm(visible, axis=1)
    known: Floats = apart[np.isfinite(apart)]
    return known
