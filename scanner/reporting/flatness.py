"""How flat the faces came out, and the angles between them, measured on the points themselves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats
from scanner.measuring import AngleMeasurement, FaceMeasurement, measure_faces
from scanner.quantities import Quantity, shown_unit
from scanner.reporting import maps
from scanner.reporting.contents import ReportInput
from scanner.reporting.sections import ScaledMap, picture

_SHOWN_SHARE = 99
_MAP_SIDE = 640


@dataclass(frozen=True)
class FlatnessRow:
    """A face as text: its name, points, mean absolute distance from its plane, and the band that 99.7 % are in."""

    name: str
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Flatness:
    """`map`: distances from the faces' planes over the camera's image; `angles`: pairs and degrees as text."""

    map: ScaledMap
    rows: tuple[FlatnessRow, ...]
    angles: tuple[tuple[str, str], ...]


def flatness(report: ReportInput) -> Flatness | None:
    """The faces of the cloud; None without a cloud or labelled faces."""
    cloud, face = report.cloud, report.sample.face
    if cloud is None or face is None:
        return None
    pixel = np.rint(report.sample.camera_px).astype(np.int64)
    height, width = cloud.points.shape[:2]
    inside = np.all((pixel >= 0) & (pixel < (width, height)), axis=1)
    face, pixel = face[inside], pixel[inside]
    points = cloud.points[pixel[:, 1], pixel[:, 0]].astype(np.float64)
    there = np.isfinite(points[:, 2])
    faces, angles = measure_faces(points[there], pixel[there], face[there], width)
    if not faces:
        return None
    unit = shown_unit(cloud.unit)
    rows = tuple(
        FlatnessRow(face.name, (unit.error(face.errors.mean_absolute), unit.error(face.errors.form))) for face in faces
    )
    painted = _map(faces, (width, height), report.cell_px, unit.factor, unit.name)
    return Flatness(painted, rows, tuple(map(_shown, angles)))


def _map(faces: tuple[FaceMeasurement, ...], size: tuple[int, int], step: int, factor: float, unit: str) -> ScaledMap:
    off: Floats = factor * np.concatenate([face.errors.residual for face in faces])
    pixel = np.concatenate([face.errors.pixel for face in faces])
    grid: NDArray[np.float32] = np.full(((size[1] - 1) // step + 1, (size[0] - 1) // step + 1), np.nan, np.float32)
    grid[tuple((pixel // step).T[::-1])] = off
    painted, scale = maps.signed_map(grid, float(np.percentile(np.abs(off), _SHOWN_SHARE)) or 1e-6, unit, _MAP_SIDE)
    return ScaledMap(picture(painted, "distances of the faces' points from their planes"), scale)


def _shown(angle: AngleMeasurement) -> tuple[str, str]:
    sigma = angle.sigma_deg if np.isfinite(angle.sigma_deg) else None
    quantity = Quantity("", angle.angle_deg, "°", sigma)
    known = f" ± {quantity.shown(sigma)}°" if sigma else ""
    return f"{angle.faces[0]}–{angle.faces[1]}", f"{quantity.shown(angle.angle_deg)}°{known}"
