"""Flatness of the faces and the angles between them, measured on the points themselves."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Size
from calib.numerics import Floats
from scanner.measuring import AngleMeasurement, FaceMeasurement, angle_cells
from scanner.quantities import fine_unit
from scanner.reporting import maps
from scanner.reporting.contents import ReportInput
from scanner.reporting.sections import ScaledMap, picture

_SHOWN_SHARE = 99
_MAP_SIDE = 640


@dataclass(frozen=True)
class FlatnessRow:
    """A face as text: its name, flatness with its sigma, and the band that 99.7 % of its points are in."""

    name: str
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Flatness:
    """`map`: distances from the faces' planes over the camera's image; `unit`: of the rows; `angles`: pairs and degrees
    as text.
    """

    map: ScaledMap
    unit: str
    rows: tuple[FlatnessRow, ...]
    angles: tuple[tuple[str, str], ...]


def flatness(report: ReportInput) -> Flatness | None:
    """The faces; None without a calibration or labelled faces."""
    scene, reconstructed = report.scene, report.reconstructed
    if scene is None or reconstructed is None or not scene.faces:
        return None
    unit = fine_unit(reconstructed.calibration.unit)
    rows = tuple(
        FlatnessRow(face.name, (unit.measured(face.deviation, face.budget.sigma), unit.number(face.errors.form)))
        for face in scene.faces
    )
    painted = _map(scene.faces, report.metadata.camera_size, report.cell_px, unit.factor, unit.name)
    return Flatness(painted, unit.name, rows, tuple(map(_shown, scene.angles)))


def _map(faces: tuple[FaceMeasurement, ...], size: Size, step: int, factor: float, unit: str) -> ScaledMap:
    off: Floats = factor * np.concatenate([face.errors.residual for face in faces])
    pixel = np.concatenate([face.errors.pixel for face in faces])
    grid = maps.on_grid(pixel, off, size, step)
    painted, scale = maps.signed_map(grid, float(np.percentile(np.abs(off), _SHOWN_SHARE)) or 1e-6, unit, _MAP_SIDE)
    return ScaledMap(picture(painted, "distances of the faces' points from their planes"), scale)


def _shown(angle: AngleMeasurement) -> tuple[str, str]:
    return "–".join(angle.faces), " ".join(angle_cells(angle))
