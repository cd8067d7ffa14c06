"""Calibration, poses and points as a COLMAP model in text form (cameras.txt, images.txt, points3D.txt), with the
calibration's covariance beside it (covariance.txt), which COLMAP itself leaves unread.

COLMAP's world is the (newest) camera's frame: x right, y down, z forward, as here; that of a whole room is the room's
frame. Its pixels are not as here: the centre of the top left one is at (0.5, 0.5), so half a pixel is added to every
principal point and every image point.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Intrinsics, Pose
from calib.numerics import Floats, Ints
from scanner.cleaning import read_cleaned
from scanner.exporting.covariance import COVARIANCE_FILE, ExportedCovariance, covariance_of_result
from scanner.exporting.formats import ExportRequest
from scanner.io import new_files, refuse_existing
from scanner.quantities import unit_name
from scanner.results import FinishedScan, read_calibration_of

COLMAP_FILES = ("cameras.txt", "images.txt", "points3D.txt")
CAMERA_ID, PROJECTOR_ID = 1, 2
CAMERA_IMAGE, PROJECTOR_IMAGE = "camera.png", "projector.png"

_HALF_PIXEL = 0.5


@dataclass(frozen=True)
class ModelSize:
    """The number of the cloud's points in a model: one from each square of `step` × `step` camera pixels."""

    points: int
    step: int


@dataclass(frozen=True)
class _Chosen:
    """A scan at its place, X_world = rotation X_camera + translation, and which of its points go into the model."""

    scan: FinishedScan
    place: Pose
    points: Ints


def export(request: ExportRequest) -> list[str]:
    """Write the model. Raises InputError and OSError."""
    result = read_cleaned(request.result, request.capture)
    scans = [(station.scan, station.place) for station in result.stations_before_camera]
    covariance = covariance_of_result(request.result, read_calibration_of(request.result))
    model = write_colmap(request.out, scans, covariance, most_points=request.most_points, overwrite=request.overwrite)
    chosen = "all of them" if model.step == 1 else f"one for each {model.step} × {model.step} camera pixels"
    total, unit = sum(len(scan) for scan, _ in scans), unit_name(result.unit)
    sentences = [f"{model.points:,} of {total:,} points{result.of_how_many} with their tracks ({chosen}), in {unit}"]
    return sentences if covariance is None else [*sentences, f"The covariance of both devices in {COVARIANCE_FILE}"]


def write_colmap(
    folder: Path,
    scans: Sequence[tuple[FinishedScan, Pose]],
    covariance: ExportedCovariance | None,
    *,
    most_points: int,
    overwrite: bool,
) -> ModelSize:
    """Write a model of scans by one rig, each with its pose, with at most `most_points` points, spread evenly over the
    images; and the covariance of the rig, if there is one.

    Raises InputError if a file exists and may not be replaced.
    """
    names = COLMAP_FILES if covariance is None else (*COLMAP_FILES, COVARIANCE_FILE)
    for name in (*COLMAP_FILES, COVARIANCE_FILE):
        refuse_existing(folder / name, overwrite=overwrite)
    chosen = [(scan, place, *_evenly(scan.pixel, most_points // len(scans))) for scan, place in scans]
    every = [_Chosen(scan, place, points) for scan, place, points, _ in chosen]
    contents = [_cameras(every[0].scan), _images(every), _points(every)]
    if covariance is not None:
        contents.append(covariance.lines)
    with new_files(folder, names, overwrite=overwrite) as paths:
        for path, lines in zip(paths, contents, strict=True):
            with path.open("w", encoding="utf-8") as file:
                file.writelines(f"{line}\n" for line in lines)
    if covariance is None:
        (folder / COVARIANCE_FILE).unlink(missing_ok=True)  # of another calibration
    return ModelSize(sum(len(view.points) for view in every), max(step for *_, step in chosen))


def _evenly(pixel: Ints, most: int) -> tuple[Ints, int]:
    """Indices of the points at every `step`-th row and column, for the smallest step that leaves at most this many."""
    step = max(1, int(np.sqrt(len(pixel) / most)))
    while True:
        chosen = np.flatnonzero(np.all(pixel % step == step // 2, axis=1))
        if len(chosen) <= most:
            return chosen, step
        step += 1


def _cameras(scan: FinishedScan) -> Iterator[str]:
    yield "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
    yield f"{CAMERA_ID} {_camera_model(scan.calibration.camera)}"
    yield f"{PROJECTOR_ID} {_camera_model(scan.calibration.projector)}"


def _camera_model(device: Intrinsics) -> str:
    """OPENCV has k1 k2 p1 p2; a k3 needs FULL_OPENCV, which continues with k3 k4 k5 k6."""
    k1, k2, p1, p2, k3 = device.distortion
    x0, y0 = device.principal_point_px
    parameters = [*device.focal_px, x0 + _HALF_PIXEL, y0 + _HALF_PIXEL, k1, k2, p1, p2]
    if k3:
        parameters += [k3, 0.0, 0.0, 0.0]
    return f"{'FULL_OPENCV' if k3 else 'OPENCV'} {device.width} {device.height} {_numbers(parameters)}"


def _images(every: Sequence[_Chosen]) -> Iterator[str]:
    """A line with the pose, world to image, and a line with the image points, for each of the two devices."""
    matched, points = sum(view.scan.matched for view in every), sum(len(view.points) for view in every)
    unit = " ".join(every[0].scan.unit.split())
    yield f"# {matched} matches, of which {points} are in this model; unit: {unit}"
    yield "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
    yield "# POINTS2D[] as X Y POINT3D_ID"
    first = 1
    for number, view in enumerate(every):
        calibration, matches = view.scan.calibration, view.scan.matches[view.points]
        to_camera = view.place.inverse()
        ending = f"-{number + 1}" if len(every) > 1 else ""
        for device, name, pose, pixels in (
            (CAMERA_ID, CAMERA_IMAGE, to_camera, matches.camera_px),
            (PROJECTOR_ID, PROJECTOR_IMAGE, calibration.pose @ to_camera, matches.projector_px),
        ):
            x, y, z, w = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
            stem, suffix = name.split(".")
            numbers = _numbers([w, x, y, z, *(pose.translation + 0.0)])  # no −0
            yield f"{2 * number + device} {numbers} {device} {stem}{ending}.{suffix}"
            ideal = (pixels + _HALF_PIXEL).tolist()
            yield " ".join(f"{x:.4f} {y:.4f} {index}" for index, (x, y) in enumerate(ideal, start=first))
        first += len(view.points)


def _points(every: Sequence[_Chosen]) -> Iterator[str]:
    """Format the points; each is observed by both devices."""
    yield "# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX"
    first = 1
    for number, view in enumerate(every):
        scan, chosen = view.scan, view.points
        error = _reprojection_error_px(scan, chosen)
        points = view.place @ scan.points[chosen]
        rows = zip(points.tolist(), scan.colours[chosen].tolist(), error.tolist(), strict=True)
        for index, ((x, y, z), (red, green, blue), miss) in enumerate(rows):
            track = f"{2 * number + CAMERA_ID} {index} {2 * number + PROJECTOR_ID} {index}"
            yield f"{first + index} {x:.9g} {y:.9g} {z:.9g} {red} {green} {blue} {miss:.6g} {track}"
        first += len(chosen)


def _reprojection_error_px(scan: FinishedScan, chosen: Ints) -> Floats:
    """Mean over both images of the distance between a point's image and the pixel that it was seen at, (N,)."""
    calibration, matches, points = scan.calibration, scan.matches[chosen], scan.points[chosen]
    in_projector = calibration.pose @ points
    in_camera_px = calibration.camera.project(points) - matches.camera_px
    in_projector_px = calibration.projector.project(in_projector) - matches.projector_px
    error: Floats = 0.5 * (np.hypot(*in_camera_px.T) + np.hypot(*in_projector_px.T))
    return error


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
