"""Residuals of the matches: maps, histograms, and whether they are random or systematic.

Flatness of the faces and the angles between them, measured on the points themselves.
"""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from calib.diagnostics import SpatialCorrelation, spatial_correlation
from calib.geometry import Calibration, Corner, Matches, Size
from calib.numerics import Floats, Ints
from calib.pointcloud import Cloud, CloudStatistics
from scanner.measuring import AngleMeasurement, FaceMeasurement, angle_cells
from scanner.quantities import fine_unit, percent
from scanner.rendering import LONGEST_SIDE
from scanner.reporting import maps, plots
from scanner.reporting.contents import ReportInput
from scanner.reporting.sections import LegendEntry, ScaledMap, picture

# Blur and noise of a decoder reach a few pixels; squares of this share of the image's width are larger.
_CELL_OF_WIDTH = 1 / 64
_HALF_PAGE = 480
_SHOWN_SHARE = 99
_MAP_SIDE = 640


@dataclass(frozen=True)
class ResidualMaps:
    """`maps` with a caption each, a `histogram` of them, and the result of the test as a sentence."""

    maps: tuple[tuple[ScaledMap, str], ...]
    histogram: Markup
    total_px: float
    statement: str
    structured: bool


@dataclass(frozen=True)
class RayGaps:
    """The distances between the two rays of the matches, and how many matches were kept."""

    residuals: ResidualMaps
    statistics: CloudStatistics
    fates: tuple[LegendEntry, ...]


def face_residuals(report: ReportInput) -> ResidualMaps | None:
    """Matches on the three faces against the corner, in x and y of the projector; None without a solution."""
    solution, sample = report.solution, report.on_faces
    if solution is None or sample.face is None or not len(sample):
        return None
    residual_px = _off_the_corner(sample, sample.face, solution.calibration, solution.corner)
    known = np.isfinite(residual_px).all(axis=1)
    pixel, residual_px = sample.camera_px[known], residual_px[known]
    if not len(pixel):
        return None
    size = report.metadata.camera_size
    limit = float(np.percentile(np.abs(residual_px), _SHOWN_SHARE)) or 1e-3
    drawn = tuple(
        (_map(maps.on_grid(pixel, residual_px[:, axis], size, report.cell_px), limit, f"residuals in {name}"), caption)
        for axis, (name, caption) in enumerate((name, f"Along the {report.metadata.second}'s {name}.") for name in "xy")
    )
    label = f"residual on the faces ({report.metadata.pixels})"
    histogram = plots.residual_histogram([*residual_px.T], None, limit, label)
    return _judged(drawn, histogram, pixel, residual_px, size)


def _off_the_corner(matches: Matches, face: Ints, calibration: Calibration, corner: Corner) -> Floats:
    """Projector pixels minus where the corner has them, (N, 2): the ray of the camera's pixel meets its face there."""
    normals = corner.normals[face]
    rays = calibration.camera.unproject(matches.camera_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = (normals @ corner.vertex / np.sum(normals * rays, axis=1))[:, None] * rays
    predicted = calibration.projector.project(calibration.pose @ points)
    return matches.projector_px - predicted


def misses(report: ReportInput) -> RayGaps | None:
    """Compute where and by how much the rays of the matches miss each other; None where nothing was measured that could
    miss.
    """
    if report.reconstructed is None:
        return None
    if report.outcome.decoded.only_axis:  # the other coordinate is defined by the intersection of the rays
        return None
    cloud = report.reconstructed.cloud
    sampled = cloud.residual_px.ravel()[report.pixels].astype(np.float64)
    if not np.isfinite(sampled).any():
        return None
    statistics = cloud.statistics
    limit = _shown_range(report, cloud)
    close = np.abs(sampled) <= statistics.limit_px
    residual_px, at = sampled[close], report.pixels[close]
    pixel = np.stack(np.divmod(at, cloud.residual_px.shape[1])[::-1], axis=1).astype(np.float64)
    painted = _map(cloud.residual_px, limit, "misses of the rays", LONGEST_SIDE)
    label = f"miss ({report.metadata.pixels})"
    histogram = plots.residual_histogram([residual_px], statistics.decoder_px, limit, label)
    residuals = _judged(((painted, ""),), histogram, pixel, residual_px, report.metadata.camera_size)
    return RayGaps(residuals, statistics, _outcome_legend(statistics))


def _judged(
    drawn: tuple[tuple[ScaledMap, str], ...], histogram: Markup, pixel: Floats, residual_px: Floats, size: Size
) -> ResidualMaps:
    """Residuals (N,) or (N, 2) at camera pixels (N, 2)."""
    correlation = spatial_correlation(pixel, residual_px, max(4.0, size.width * _CELL_OF_WIDTH))
    total_px = float(np.sqrt(np.sum(residual_px**2) / max(1, len(residual_px))))
    return ResidualMaps(
        drawn, histogram, total_px, statement(correlation), correlation is not None and correlation.structured
    )


def statement(correlation: SpatialCorrelation | None) -> str:
    """The test's outcome for a person."""
    if correlation is None:
        return "Too few of them are neighbours to test whether they are random."
    chance = correlation.expected + 3 * correlation.sigma
    numbers = (
        f"means over squares of {correlation.cell_px:.0f} camera pixels correlate with their neighbours' by "
        f"{correlation.correlation:.2f} (Moran's I), where chance gives less than {chance:.2f}"
    )
    if not correlation.significant:
        return f"No pattern beyond the noise: {numbers}."
    shared = f"neighbours share {correlation.shared_px:.2g} px, {percent(correlation.shared_variance)} of the variance"
    if not correlation.structured:
        return f"Nearly random, with a faint pattern: {numbers}; {shared}."
    return f"Structured: {numbers}; {shared}."


def _map(values: NDArray[np.float32], limit: float, alt: str, longest_side: int = _HALF_PAGE) -> ScaledMap:
    painted, scale = maps.signed_map(values, limit, "px", longest_side)
    return ScaledMap(picture(painted, f"{alt} over the camera's image"), scale)


def _shown_range(report: ReportInput, cloud: Cloud) -> float:
    """Half-width of the scale, which contains 99 % of the points."""
    kept = np.abs(cloud.residual_px.ravel()[report.in_cloud])
    return float(np.percentile(kept, _SHOWN_SHARE)) if len(kept) and kept.any() else cloud.statistics.limit_px


def _outcome_legend(statistics: CloudStatistics) -> tuple[LegendEntry, ...]:
    rows = (
        ("points in the cloud", statistics.kept),
        (f"rays miss each other by more than {statistics.limit_px:.2g} px", statistics.disagreeing),
        ("isolated: no neighbours on the same surface", statistics.isolated),
        ("behind a device", statistics.behind),
        ("another match of the same camera pixel is better", statistics.shared_pixel),
        ("outside of the camera's image", statistics.outside_image),
    )
    total = max(1, statistics.matched)
    return tuple(LegendEntry("", label, f"{count:,} ({percent(count / total)})") for label, count in rows if count)


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
    painted = _flatness_map(scene.faces, report.metadata.camera_size, report.cell_px, unit.factor, unit.name)
    return Flatness(painted, unit.name, rows, tuple(map(_shown, scene.angles)))


def _flatness_map(faces: tuple[FaceMeasurement, ...], size: Size, step: int, factor: float, unit: str) -> ScaledMap:
    off: Floats = factor * np.concatenate([face.errors.residual for face in faces])
    pixel = np.concatenate([face.errors.pixel for face in faces])
    grid = maps.on_grid(pixel, off, size, step)
    painted, scale = maps.signed_map(grid, float(np.percentile(np.abs(off), _SHOWN_SHARE)) or 1e-6, unit, _MAP_SIDE)
    return ScaledMap(picture(painted, "distances of the faces' points from their planes"), scale)


def _shown(angle: AngleMeasurement) -> tuple[str, str]:
    return "–".join(angle.faces), " ".join(angle_cells(angle))
