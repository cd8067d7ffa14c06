"""Sections of a result's surface by planes: contours, with their lengths and what these are known to.

Contours as a table (CSV), and as a drawing: SVG, and DXF in the result's unit, by ezdxf.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import scipy

from calib.diagnostics import SystematicErrors, length_in_the_middle
from calib.geometry import tangent_basis
from calib.numerics import Floats, Ints
from calib.pointcloud import point_covariances
from calib.refusal import NoMeasurementError
from scanner.cleaning import CleanedResult
from scanner.errors import InputError
from scanner.exporting import Mesh, mesh_in_axes
from scanner.quantities import UNKNOWN_UNIT, parse_coordinates, parse_length, shown_unit, unit_name
from scanner.results import FinishedScan

MOST_PLANES = 1000
_AXES = {"x": 0, "y": 1, "z": 2}
_LEAST_NORMAL = 1e-9
# A contour is drawn through its points within so many of their standard deviations: without that, noise lengthens it.
_TOLERANCE = 2.0
SECTION_FILES = ("section.csv", "section.svg", "section.dxf")
_WIDTH, _MARGIN, _LINE = 900, 40, 24
_NUMBER = 20.0, 14.0  # width and height of a contour's number
_NAMED = 12  # lengths that a drawing names
_UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6}  # $INSUNITS; 0 is none


@dataclass(frozen=True, eq=False)
class CuttingPlane:
    """`normal` · X = `offset`, in the axes of the result's cloud, or of its steps."""

    normal: Floats
    offset: float
    name: str
    """As in 'z = 1.2'."""
    axes: Floats
    """(2, 3): the directions of the drawing's x and y."""


@dataclass(frozen=True, eq=False)
class Contour:
    """A line in which a plane cuts the surface."""

    plane: CuttingPlane
    points: Floats
    """(N, 2) along the plane's axes; of a closed one the first is not repeated."""
    is_closed: bool
    length: float
    sigma: float | None
    """Of the length, by the calibration and the noise of its ends; None where the calibration states no covariance."""


def parse_plane(text: str, unit: str) -> CuttingPlane:
    """'z=1.2m', or a normal and an offset, as in '0,0.6,0.8,1.2m'. Raises InputError."""
    name, equals, offset = text.partition("=")
    if equals and name.strip() in _AXES:
        normal = np.eye(3)[_AXES[name.strip()]]
        return _plane(normal, parse_coordinates(offset, unit, 1)[0], name.strip())
    *parts, offset = text.split(",")
    try:
        normal = np.array([float(part) for part in parts])
    except ValueError:
        normal = np.zeros(0)
    if len(normal) != 3 or not np.isfinite(normal).all() or not np.linalg.norm(normal) > _LEAST_NORMAL:
        raise InputError(f"--plane: expected z=1.2m, or a normal and an offset, as in 0,0.6,0.8,1.2m, found '{text}'")
    normal = normal / np.linalg.norm(normal)
    return _plane(normal, parse_coordinates(offset, unit, 1)[0], ",".join(parts))


def _plane(normal: Floats, offset: float, name: str) -> CuttingPlane:
    """Across an axis of the cloud, the drawing has the two others."""
    axis = int(np.argmax(np.abs(normal)))
    across = np.eye(3)[[1, 2] if axis == 0 else [0, 2] if axis == 1 else [0, 1]]
    is_axis = np.abs(normal[axis]) == 1
    return CuttingPlane(normal, offset, f"{name} = {offset:.6g}", across if is_axis else tangent_basis(normal).T)


def parallel_planes(plane: CuttingPlane, every: str, points: Floats, unit: str) -> list[CuttingPlane]:
    """Through all points (N, 3), at an interval. Raises InputError if these are too many."""
    step, along = parse_length(every, unit), points @ plane.normal
    low, high = (float(edge) - plane.offset for edge in (along.min(), along.max()))
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    if last - first + 1 > MOST_PLANES:
        raise InputError(f"--every {every}: expected {MOST_PLANES:,} planes or fewer, found {last - first + 1:,}")
    name = plane.name.partition(" = ")[0]
    offsets = (plane.offset + number * step for number in range(first, last + 1))
    return [replace(plane, offset=offset, name=f"{name} = {offset:.6g}") for offset in offsets]


def cut(
    result: CleanedResult, planes: Sequence[str], every: str | None, errors: SystematicErrors | None
) -> tuple[Contour, ...]:
    """The contours in which planes, described, cut the surface, the longest of each first; `every`: an interval at
    which each is repeated. Raises InputError if a plane meets no triangle.
    """
    mesh = mesh_in_axes(result)
    contours: list[Contour] = []
    noise = _noise(result)
    for text in planes:
        plane = parse_plane(text, mesh.unit)
        along = mesh.points @ plane.normal
        if every is None and not along.min() <= plane.offset <= along.max():
            raise InputError(
                f"--plane {text}: meets no triangle: the surface reaches from {along.min():.4g} to {along.max():.4g} "
                f"{unit_name(mesh.unit)} there"
            )
        for section_plane in [plane] if every is None else parallel_planes(plane, every, mesh.points, mesh.unit):
            lines = [
                _contour(section_plane, *line, result, errors, noise) for line in section_lines(mesh, section_plane)
            ]
            contours += sorted((line for line in lines if line is not None), key=lambda contour: -contour.length)
    if not contours:
        raise InputError("the planes meet no triangle: choose others, or --every with a smaller interval")
    return tuple(contours)


def section_lines(mesh: Mesh, plane: CuttingPlane) -> list[tuple[Floats, bool]]:
    """Lines of points (N, 3) in which a plane cuts a mesh, and whether each is closed."""
    above = mesh.points @ plane.normal - plane.offset
    side = above[mesh.triangles] >= 0
    crossing = mesh.triangles[side.any(axis=1) & ~side.all(axis=1)]
    if not len(crossing):
        return []
    edges = np.sort(np.stack([crossing, np.roll(crossing, -1, axis=1)], axis=-1), axis=-1)  # (T, 3, 2)
    cuts = (above[edges[..., 0]] >= 0) != (above[edges[..., 1]] >= 0)
    nodes, number = np.unique(edges[cuts], axis=0, return_inverse=True)
    share = above[nodes[:, 0]] / (above[nodes[:, 0]] - above[nodes[:, 1]])
    points = mesh.points[nodes[:, 0]] + share[:, None] * (mesh.points[nodes[:, 1]] - mesh.points[nodes[:, 0]])
    links = number.reshape(-1, 2)  # of each triangle, two edges are cut
    return [(points[chain], is_closed) for chain, is_closed in _chains(links, len(nodes))]


def _chains(links: Ints, count: int) -> list[tuple[Ints, bool]]:
    """Paths through nodes that links (L, 2) join, from the ends on; then the closed ones."""
    at: list[list[int]] = [[] for _ in range(count)]
    for link, (first, second) in enumerate(links.tolist()):
        at[first].append(link)
        at[second].append(link)
    ends, unused = links.tolist(), np.ones(len(links), np.bool_)
    starts = [node for node in range(count) if len(at[node]) != 2] + list(range(count))
    chains = []
    for start in starts:
        while further := [link for link in at[start] if unused[link]]:
            chain = [start]
            while further:
                unused[further[0]] = False
                first, second = ends[further[0]]
                node = second if chain[-1] == first else first
                chain.append(node)
                # Where more than two links meet, a line ends.
                further = [link for link in at[node] if unused[link]] if len(at[node]) == 2 else []
            is_closed = len(chain) > 3 and chain[0] == chain[-1]
            chains.append((np.array(chain[:-1] if is_closed else chain), is_closed))
    return chains


@dataclass(frozen=True, eq=False)
class _Noise:
    """Of the points of one scan."""

    tree: "scipy.spatial.cKDTree"
    """Of the points, in the axes of the result."""
    scan: FinishedScan

    def at(self, points: Floats) -> float:
        """The median standard deviation of what is nearest to points (N, 3)."""
        chosen = np.unique(np.asarray(self.tree.query(points)[1]))
        covariance = point_covariances(self.scan.matches[chosen], self.scan.calibration)
        return float(np.median(np.sqrt(np.trace(covariance, axis1=1, axis2=2))))


def _noise(result: CleanedResult) -> _Noise | None:
    """None of several scans, or without a sigma."""
    if len(result.stations) != 1:
        return None
    (station,) = result.stations
    scan = station.scan
    return None if scan.matches.sigma_px is None else _Noise(scipy.spatial.cKDTree(station.place @ scan.points), scan)


def _contour(
    plane: CuttingPlane,
    points: Floats,
    is_closed: bool,
    result: CleanedResult,
    errors: SystematicErrors | None,
    noise: _Noise | None,
) -> Contour | None:
    """None for a crumb that is smaller than the noise."""
    scatter = 0.0 if noise is None else noise.at(points)
    flat = points @ plane.axes.T
    if scatter > 0 and len(flat) > 2:
        centre = flat.mean(axis=0)  # single precision is enough about it
        fewer = cv2.approxPolyDP((flat - centre).astype(np.float32), _TOLERANCE * scatter, is_closed)
        flat = fewer.reshape(-1, 2).astype(np.float64) + centre
    around = np.concatenate([flat, flat[:1]]) if is_closed else flat
    length = float(np.sum(np.linalg.norm(np.diff(around, axis=0), axis=1)))
    if length <= 2 * _TOLERANCE * scatter:
        return None
    relative = _relative_sigma(points, result, errors)
    ends = 0.0 if is_closed else np.sqrt(2) * scatter
    sigma = None if relative is None else float(np.hypot(relative * length, ends))
    return Contour(plane, flat, is_closed, length, sigma)


def _relative_sigma(points: Floats, result: CleanedResult, errors: SystematicErrors | None) -> float | None:
    """Of lengths around the middle of points (N, 3), as the newest scan sees them."""
    if errors is None or not errors.known or not result.stations:
        return None
    in_camera = result.stations[-1].place.inverse() @ points
    try:
        return length_in_the_middle(in_camera, errors).sigma
    except NoMeasurementError:
        return None  # that scan does not see this part


def write_section_table(path: Path, contours: Sequence[Contour], unit: str) -> None:
    """A line for each contour, the lengths in `unit`. Raises OSError."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("plane", "contour", "points", "closed", "length", "length_sigma", "unit"))
        for number, contour in enumerate(contours, start=1):
            sigma = "" if contour.sigma is None else f"{contour.sigma:.6g}"
            row = (contour.plane.name, number, len(contour.points), int(contour.is_closed), f"{contour.length:.9g}")
            writer.writerow((*row, sigma, unit))


def write_section_svg(path: Path, contours: Sequence[Contour], unit: str) -> None:
    """All contours on one page, seen against the plane's normal, with the lengths of the longest. Raises OSError."""
    every = np.concatenate([contour.points for contour in contours])
    low, extent = every.min(axis=0), np.maximum(np.ptp(every, axis=0), 1e-12)
    scale = (_WIDTH - 2 * _MARGIN) / float(extent.max())
    height = scale * float(extent[1]) + 2 * _MARGIN
    longest = sorted(enumerate(contours, start=1), key=lambda pair: -pair[1].length)[:_NAMED]
    length_unit = shown_unit(unit)
    numbers: list[tuple[float, float]] = []
    with path.open("w", encoding="utf-8") as file:
        whole = height + _LINE * len(longest)
        file.write(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {whole:.0f}"><style>text{{font:14px '
            f'system-ui,sans-serif}}path{{fill:none;stroke:#222}}</style><rect width="{_WIDTH}" '
            f'height="{whole:.0f}" fill="#fff"/>\n'
        )
        for number, contour in enumerate(contours, start=1):
            x, y = (scale * (contour.points - low) + _MARGIN).T
            y = height - y
            steps = " L".join(f"{a:.2f} {b:.2f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
            file.write(f'<path d="M{steps}{" Z" if contour.is_closed else ""}"/>\n')
            if any(number == named for named, _ in longest):
                numbers.append(_free_place(np.stack([x, y], axis=1), numbers))
                across, down = numbers[-1]
                file.write(f'<text x="{across:.1f}" y="{down:.1f}">{number}</text>\n')
        for line, (number, contour) in enumerate(longest, start=1):
            length = length_unit.length(contour.length, contour.sigma)
            words = f"{number}: {length} ({contour.plane.name} {unit_name(unit)})"
            file.write(f'<text x="{_MARGIN}" y="{height + _LINE * line - 8:.0f}">{words}</text>\n')
        file.write("</svg>\n")


def _free_place(contour: Floats, taken: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """A place (2,) for a number: the point of its contour (N, 2) that is furthest from other numbers, or below it where
    these are as near as that.
    """
    if not taken:
        return float(contour[0, 0]), float(contour[0, 1])
    apart = np.linalg.norm(contour[:, None] - np.array(taken), axis=2).min(axis=1)
    across, down = contour[np.argmax(apart)].tolist()
    while min(max(abs(across - x) / _NUMBER[0], abs(down - y) / _NUMBER[1]) for x, y in taken) < 1:
        down += _NUMBER[1] / 2
    return across, down


def write_section_dxf(path: Path, contours: Sequence[Contour], unit: str) -> None:
    """A layer for each plane, a polyline for each contour, and its length at its beginning. Raises OSError."""
    from ezdxf.filemanagement import new  # which takes long to load

    document = new("R2010", setup=True)
    document.header["$INSUNITS"] = 0 if unit == UNKNOWN_UNIT else _UNITS.get(unit, 0)
    space, length_unit = document.modelspace(), shown_unit(unit)
    size = 0.02 * float(np.ptp(np.concatenate([contour.points for contour in contours]), axis=0).max())
    for contour in contours:
        layer = contour.plane.name.replace("=", "at").replace(",", " ")
        points = [(float(x), float(y)) for x, y in contour.points.tolist()]
        space.add_lwpolyline(points, close=contour.is_closed, dxfattribs={"layer": layer})
        text = space.add_text(
            length_unit.length(contour.length, contour.sigma), height=size, dxfattribs={"layer": "LENGTHS"}
        )
        text.set_placement(points[0])
    document.saveas(path)
