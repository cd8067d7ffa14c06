"""The point cloud for the viewer in the page: thinned, in whole numbers, with outlines of faces and devices."""

import base64
import json
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import IDENTITY, Calibration, Intrinsics, Pose
from calib.numerics import Floats
from calib.pointcloud import Cloud, MergedCloud
from scanner.quantities import FACE_NAMES, device_names, shown_unit
from scanner.rendering import FACE_COLOURS, Colour, css_colour, frustum
from scanner.reporting.contents import ReportInput
from scanner.reporting.sections import FRUSTUM_LENGTH, typical_depth, upright
from scanner.results import Reconstructed

# At twelve bytes each, about a megabyte of the page.
_MOST_POINTS = 70_000
_STEPS = 65_535
_HULL_SAMPLE = 5_000
_OFF_THE_FACE = 6.0
_WHITE_PERCENTILE = 99
# Squares slightly larger than the grid close gaps on oblique surfaces.
_SPLAT_OF_GRID = 1.9
_SPACING_SAMPLE, _NEIGHBOURS = 1000, 8
CAMERA_COLOUR, PROJECTOR_COLOUR = "--accent", "--second"
_UPRIGHT_OF_CORNER = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class View3d:
    """`points`: base64 of a record of 12 bytes for each point, little endian: three 16-bit steps along the box's edges,
    RGB, and the normal times 127. `scene`: JSON with everything else. `count` of `total` points are in it.
    """

    points: str
    scene: str
    count: int
    total: int


def view3d(report: ReportInput) -> View3d | None:
    """The merged cloud if there is one, else the capture's own; None without a cloud."""
    reconstructed, merged = report.reconstructed, report.joint.merged
    if reconstructed is None:
        return None
    cloud = merged if merged is not None and len(merged.points) else reconstructed.cloud
    total = len(cloud.points) if isinstance(cloud, MergedCloud) else cloud.statistics.kept
    if not total or not len(report.in_cloud):
        return None
    points, colours, normals, grid = _thinned(report, reconstructed, cloud, total)
    orientation = _orientation(report, cloud, points)
    thinned = Thinned(points, colours, normals, grid, total)
    return turning_view(thinned, orientation, _outlines(report, reconstructed, cloud), reconstructed.calibration.unit)


class Thinned(NamedTuple):
    """Some points (n, 3) of a cloud of `total`, their colours, RGB, and normals, and the distance of neighbours."""

    points: Floats
    colours: NDArray[np.uint8]
    normals: NDArray[np.floating]
    grid: float
    total: int

    @classmethod
    def of(cls, points: NDArray[np.floating], colours: NDArray[np.uint8], normals: NDArray[np.floating]) -> "Thinned":
        """An even choice of any cloud."""
        chosen = np.sort(np.random.default_rng(0).permutation(len(points))[:_MOST_POINTS])
        some = points[chosen].astype(np.float64)
        sample = some[:: max(1, len(some) // _SPACING_SAMPLE)]
        within = np.asarray(scipy.spatial.cKDTree(some).query(sample, min(1 + _NEIGHBOURS, len(some)))[0])[:, -1]
        grid = float(np.median(within)) * np.sqrt(np.pi / _NEIGHBOURS)
        return cls(some, colours[chosen], normals[chosen], grid, len(points))


def turning_view(
    thinned: Thinned, orientation: dict[str, list[float]], lines: list[dict[str, object]], unit: str
) -> View3d:
    """For the viewer: `orientation` as of `looking`, and outlines in the cloud's frame, as of `device_lines`."""
    points, display_unit = thinned.points, shown_unit(unit)
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    scene = {
        "count": len(points),
        "low": _rounded(low),
        "size": _rounded(size),
        "splat": float(f"{_SPLAT_OF_GRID * thinned.grid:.4g}"),
        "unit": [display_unit.factor, display_unit.name],
        **orientation,
        "lines": lines,
    }
    packed = _packed((points - low) / size, thinned.colours, thinned.normals)
    return View3d(packed, json.dumps(scene, separators=(",", ":")), len(points), thinned.total)


def looking(forward: Floats, up: Floats, points: NDArray[np.floating]) -> dict[str, list[float]]:
    """The initial view: along `forward`, `up` at the top, around the middle of points (n, 3)."""
    return {"up": _rounded(up), "forward": _rounded(forward), "centre": _rounded(np.median(points, axis=0))}


def device_lines(device: Intrinsics, place: Pose, length: float, colour: str, name: str) -> list[dict[str, object]]:
    """A device with its pose as a pyramid of this length, with its name; the colour is one of the page's."""
    pyramid = place @ frustum(device, length)
    path = np.concatenate([pyramid[4:, 0], pyramid[4:5, 0]])
    edges = [(path, name), *((edge, "") for edge in pyramid[:4])]
    return [
        {"colour": colour, "text": text, "closed": False, "at": [_rounded(point) for point in edge]}
        for edge, text in edges
    ]


def _thinned(
    report: ReportInput, reconstructed: Reconstructed, cloud: Cloud | MergedCloud, total: int
) -> tuple[Floats, NDArray[np.uint8], NDArray[np.float32], float]:
    """Points (n, 3), colours, normals, and the typical distance of neighbours."""
    if isinstance(cloud, MergedCloud):
        stride = max(1, ceil(total / _MOST_POINTS))
        chosen: tuple[slice, ...] = (slice(None, None, stride),)
        grid = cloud.grid * np.sqrt(stride)
    else:
        stride = max(1, ceil(np.sqrt(total / _MOST_POINTS)))
        chosen = (slice(None, None, stride),) * 2
        grid = stride * typical_depth(report, cloud) / reconstructed.calibration.camera.focal_px[0]
    there = np.isfinite(cloud.points[chosen][..., 2])
    colours = cloud.colours[chosen][there]
    white = max(1.0, float(np.percentile(colours, _WHITE_PERCENTILE))) if len(colours) else 255.0
    table = np.rint(255 * np.clip(np.arange(256) / white, 0, 1) ** 0.8).astype(np.uint8)
    return cloud.points[chosen][there].astype(np.float64), table[colours], cloud.normals[chosen][there], float(grid)


def _packed(shares: Floats, colours: NDArray[np.uint8], normals: NDArray[np.floating]) -> str:
    records = np.zeros(len(shares), dtype=[("at", "<u2", 3), ("rgb", "u1", 3), ("normal", "i1", 3)])
    records["at"] = np.rint(_STEPS * shares)
    records["rgb"] = colours
    records["normal"] = np.rint(127 * np.nan_to_num(normals))
    return base64.b64encode(records.tobytes()).decode("ascii")


def _orientation(report: ReportInput, cloud: Cloud | MergedCloud, points: Floats) -> dict[str, list[float]]:
    """Return the initial orientation of the view: along `forward`, `up` at the top, around the `centre`."""
    middle = np.median(points, axis=0)
    if isinstance(cloud, MergedCloud):
        up = _UPRIGHT_OF_CORNER * (1.0 if middle[2] >= 0 else -1.0)
        forward = -np.array([middle[0], middle[1], 0.0])
    else:
        up, forward = upright(report), np.array([0.0, 0.0, 1.0])
    return looking(forward, up, points)


def _outlines(report: ReportInput, reconstructed: Reconstructed, cloud: Cloud | MergedCloud) -> list[dict[str, object]]:
    """The faces as closed polygons with their letters, both devices as pyramids, in the cloud's frame."""
    calibrations: list[Calibration | None] = [reconstructed.calibration]
    if isinstance(cloud, MergedCloud):
        calibrations = [row.calibration for row in report.joint.rows]
        length = FRUSTUM_LENGTH * float(np.linalg.norm(np.median(cloud.points, axis=0)))
        to_cloud = cloud.from_cameras
    else:
        length = FRUSTUM_LENGTH * typical_depth(report, cloud)
        to_cloud = (IDENTITY,)
    lines: list[dict[str, object]] = []
    if to_cloud:
        # The capture of this page is the last one.
        lines += [
            {"colour": css_colour(colour), "text": name, "closed": True, "at": _moved(outline, to_cloud[-1])}
            for name, colour, outline in _faces(report, reconstructed.cloud)
        ]
    for number, (calibration, pose) in enumerate(zip(calibrations, to_cloud, strict=True), start=1):
        if calibration is None:
            continue
        names = device_names(calibration, number, len(to_cloud))
        devices = (
            (calibration.camera, pose, CAMERA_COLOUR),
            (
                calibration.projector,
                pose @ calibration.pose.inverse(),
                PROJECTOR_COLOUR,
            ),
        )
        for name, (device, place, colour) in zip(names, devices, strict=True):
            named = any(line["text"] == name for line in lines)  # the first photo is in every pair
            lines += device_lines(device, place, length, colour, "" if named else name)
    return lines


def _faces(report: ReportInput, cloud: Cloud) -> list[tuple[str, Colour, Floats]]:
    """Name, colour and convex outline (n, 3) of each labelled face, in the camera's frame."""
    sample, outlines = report.on_faces, []
    height, width = cloud.points.shape[:2]
    for label, (name, colour) in enumerate(zip(FACE_NAMES, FACE_COLOURS, strict=True)):
        on = np.flatnonzero(sample.face == label)
        on = on[:: max(1, len(on) // _HULL_SAMPLE)]
        column, row = np.rint(sample.camera_px[on]).astype(np.int64).T
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        points = cloud.points[row[inside], column[inside]].astype(np.float64)
        points = points[np.isfinite(points[:, 2])]
        if len(points) >= 3:
            outlines.append((name, colour, _outline(points)))
    return outlines


def _outline(points: Floats) -> Floats:
    """Corners (n, 3) of the convex hull of points (N, 3) in their plane, without outliers."""
    for _ in range(2):
        centre = np.median(points, axis=0)
        axes = np.linalg.svd(points - centre, full_matrices=False)[2]
        off = np.abs((points - centre) @ axes[2])
        points = points[off <= _OFF_THE_FACE * max(float(np.median(off)), 1e-9)]
    flat = ((points - centre) @ axes[:2].T).astype(np.float32)
    hull = cv2.convexHull(flat)[:, 0].astype(np.float64)
    corners: Floats = centre + hull @ axes[:2]
    return corners


def _moved(points: Floats, pose: Pose) -> list[list[float]]:
    """Points (n, 3) by a pose, rounded."""
    return [_rounded(point) for point in pose @ points]


def _rounded(values: Floats) -> list[float]:
    return [float(f"{value:.5g}") for value in values]
