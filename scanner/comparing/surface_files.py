"""A comparison of surfaces as files: coloured clouds and meshes of both, compare.html and compare.json."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Ints
from calib.registration import SurfacePose
from scanner.comparing.point_deviations import PointDeviations
from scanner.comparing.surface_comparison import SurfaceComparison
from scanner.comparing.surface_summary import quantile_rows, region_headings, region_rows, surface_verdict
from scanner.comparing.surfaces import mesh_of, nearest_values
from scanner.exporting import Mesh, write_glb
from scanner.io import write_scalar_ply
from scanner.quantities import METRES, ShownUnit, shown_unit
from scanner.rendering import SIGNED, ColourScale, css_colour, page, png_uri, shaded, splatted_view, standard_views

CLOUD_FILE, MESH_FILE = "deviation.ply", "deviation.glb"
REFERENCE_CLOUD_FILE, REFERENCE_MESH_FILE = "reference.ply", "reference.glb"
_FORMAT = 1
_NO_COUNTERPART = (120, 120, 120)
_RANGE_QUANTILE = 0.98
_BARS, _WIDE, _HIGH = 61, 640, 160
_VIEW = (900, 600)
_MOST_TRIANGLES = 400_000


@dataclass(frozen=True)
class _Picture:
    """A view of the coloured cloud."""

    uri: str
    width: int
    height: int
    alt: str
    caption: str


def colour_range(comparison: SurfaceComparison) -> float:
    """The deviation at either end of the colours: the tolerance, or what nearly all points do not exceed."""
    if comparison.test is not None:
        return comparison.test.tolerance
    distance = np.abs(comparison.compared)
    return max(float(np.quantile(distance, _RANGE_QUANTILE)) if len(distance) else 0.0, 1e-12)


def colours_of(distance: Floats, largest: float) -> NDArray[np.uint8]:
    """RGB (N, 3) of deviations (N,): blue below, red above, grey without a counterpart."""
    there: Bools = np.isfinite(distance)
    share = np.clip(0.5 + 0.5 * np.where(there, distance, 0.0) / largest, 0.0, 1.0)
    colours = shaded(share, SIGNED).copy()
    colours[~there] = _NO_COUNTERPART
    return colours


def write_deviation_cloud(path: Path, comparison: SurfaceComparison) -> None:
    """The points in the reference's frame, coloured, with `deviation` and `sigma` as numbers. Raises OSError."""
    measured = comparison.measured
    if measured is not None:
        _write_coloured(path, comparison, measured.points, measured.normals, measured.distance, measured.sigma)


def write_reference_cloud(path: Path, comparison: SurfaceComparison) -> None:
    """The reference's points, coloured by the deviations near each, with the same numbers. Raises OSError."""
    if comparison.measured is not None:
        reference = comparison.reference.sampled
        normals = np.zeros_like(reference.points) if reference.normals is None else reference.normals
        near = comparison.measured.on_reference(reference.points)
        _write_coloured(path, comparison, reference.points, normals, *near)


def _write_coloured(
    path: Path, comparison: SurfaceComparison, points: Floats, normals: Floats, distance: Floats, sigma: Floats
) -> None:
    colours = colours_of(distance, colour_range(comparison))
    frame = f"reference frame: that of {Path(comparison.names[1]).name}"
    scalars = {"deviation": distance, "sigma": sigma}
    write_scalar_ply(path, points, normals, colours, scalars, comparison.unit, frame)


def deviation_mesh(comparison: SurfaceComparison, result: Path, capture: int | None = None) -> Mesh | None:
    """The result's mesh in the reference's frame, coloured like its points; None without a mesh. Raises InputError."""
    own, best, measured = mesh_of(result, capture), comparison.registration.best, comparison.measured
    if own is None or best is None or measured is None:
        return None
    vertices, triangles = own
    points: Floats = best.pose @ (best.scale * vertices)
    distance = nearest_values(measured.points, measured.distance, points)
    normals = nearest_values(measured.points, measured.normals, points)
    return Mesh(points, normals, colours_of(distance, colour_range(comparison)), triangles, comparison.unit)


def reference_mesh(comparison: SurfaceComparison) -> Mesh | None:
    """The reference's mesh, coloured by the deviations near each vertex, in triangles that are small enough to show
    them; None of a cloud.
    """
    reference, measured = comparison.reference, comparison.measured
    if reference.triangles is None or measured is None:
        return None
    points, triangles = subdivided(reference.points, reference.triangles, measured.cells.cell)
    corners = points[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals: Floats = np.zeros_like(points)
    np.add.at(normals, triangles, facing[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    colours = colours_of(measured.on_reference(points)[0], colour_range(comparison))
    return Mesh(points, normals, colours, triangles, comparison.unit)


def subdivided(points: Floats, triangles: Ints, longest: float) -> tuple[Floats, Ints]:
    """Triangles (T, 3) between points (N, 3), whose longest sides are halved until none is longer; or until they are
    many.
    """
    while len(triangles) < _MOST_TRIANGLES:
        sides = np.linalg.norm(points[triangles] - points[np.roll(triangles, -1, axis=1)], axis=2)
        wide = sides.max(axis=1) > longest
        if not wide.any():
            break
        turn = (np.argmax(sides[wide], axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(triangles[wide], turn, axis=1).T
        halves, number = np.unique(np.sort(np.stack([a, b], axis=1), axis=1), axis=0, return_inverse=True)
        middle = len(points) + number.reshape(-1)
        points = np.concatenate([points, points[halves].mean(axis=1)])
        parts = [triangles[~wide], np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        triangles = np.concatenate(parts)
    return points, triangles


def write_deviation_mesh(path: Path, mesh: Mesh) -> None:
    """As GLB in metres; in its own numbers where no length is known. Raises OSError."""
    write_glb(path, mesh, METRES.get(mesh.unit, 1.0))


def write_surface_page(path: Path, comparison: SurfaceComparison) -> None:
    """Write the page; it needs no network and no other file. Raises OSError."""
    unit, largest = shown_unit(comparison.unit), colour_range(comparison)
    text = page(
        "surfaces.html",
        names=comparison.names,
        verdict=surface_verdict(comparison),
        scale=_legend(unit, largest) if comparison.is_aligned else None,
        views=[] if comparison.measured is None else _views(comparison.measured, largest),
        histogram=_histogram(comparison, unit, largest) if len(comparison.compared) else None,
        quantiles=quantile_rows(comparison),
        headings=region_headings(comparison),
        regions=region_rows(comparison),
        notes=comparison.notes,
    )
    path.write_text(text, encoding="utf-8")


def _legend(unit: ShownUnit, largest: float) -> ColourScale:
    shades = tuple(css_colour((int(r), int(g), int(b))) for r, g, b in SIGNED[::16])
    return ColourScale(shades, unit.error(-largest, signed=True), unit.error(largest, signed=True))


def _views(measured: PointDeviations, largest: float) -> list[_Picture]:
    colours = colours_of(measured.distance, largest)
    facing = measured.normals.mean(axis=0)
    up = np.array([0.0, 0.0, 1.0]) if abs(facing[2]) < 0.9 * np.linalg.norm(facing) else np.array([0.0, 1.0, 0.0])
    forward = -facing if np.linalg.norm(facing) > 0.2 else np.array([0.0, 1.0, 0.0])
    pictures = []
    points = measured.points - np.median(measured.points, axis=0)  # in single precision
    for name, view in standard_views(forward, up).items():
        rgba = splatted_view(points, measured.normals, colours, view, _VIEW)
        caption = {"oblique": "Obliquely", "top": "From above", "front": "From the front"}[name]
        alt = f"Deviations as colours, {caption.lower()}"
        pictures.append(_Picture(png_uri(rgba), rgba.shape[1], rgba.shape[0], alt, caption))
    return pictures


def _histogram(comparison: SurfaceComparison, unit: ShownUnit, largest: float) -> Markup:
    """How many points deviate by how much, as SVG, with the colours of the legend."""
    distance = np.clip(comparison.compared, -1.5 * largest, 1.5 * largest)
    count, edges = np.histogram(distance, _BARS, (-1.5 * largest, 1.5 * largest))
    wide, bars = _WIDE / _BARS, []
    for k, number in enumerate(count):
        high = _HIGH * number / max(1, count.max())
        red, green, blue = (int(v) for v in colours_of(np.array([(edges[k] + edges[k + 1]) / 2]), largest)[0])
        title = (
            f"{unit.number(float(edges[k]), signed=True)} to {unit.error(float(edges[k + 1]), signed=True)}: {number:,}"
        )
        bars.append(
            f'<rect x="{k * wide:.1f}" y="{_HIGH - high:.1f}" width="{wide - 1:.1f}" height="{high:.1f}" '
            f'fill="{css_colour((red, green, blue))}"><title>{title}</title></rect>'
        )
    label = "How many points deviate by how much"
    return Markup(
        f'<svg class="plot" role="img" aria-label="{label}" viewBox="0 0 {_WIDE} {_HIGH}">{"".join(bars)}</svg>'
    )


def write_surface_document(path: Path, comparison: SurfaceComparison) -> None:
    """Write all numbers but those of the points; lengths are in `unit`. Raises OSError."""
    path.write_text(json.dumps(_document(comparison), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _document(comparison: SurfaceComparison) -> dict[str, Any]:
    registration, verdict, test = comparison.registration, surface_verdict(comparison), comparison.test
    distance = comparison.compared
    return {
        "format": _FORMAT,
        "surfaces": list(comparison.names),
        "unit": comparison.unit,
        "verdict": verdict.headline,
        "grade": verdict.grade,
        "reasons": list(verdict.reasons),
        "alignment": alignment_document(comparison.registration.alignment.value, registration.best),
        "alignment_sigma": None if not comparison.is_aligned else _sigmas(registration.covariance),
        "alignment_centre": _numbers(registration.centre),
        "alignment_covariance": None
        if not comparison.is_aligned
        else [_numbers(row) for row in registration.covariance],
        "alternatives": [alignment_document("alternative", pose) for pose in registration.alternatives],
        "free": [
            {"turns": motion.turns, "direction": _numbers(motion.direction), "through": _numbers(motion.through)}
            for motion in registration.free
        ],
        "points": len(comparison.distance),
        "compared": len(distance),
        "quantiles": {
            f"{share:g}": float(f"{np.quantile(distance, share):.6g}")
            for share in (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
        }
        if len(distance)
        else {},
        "rms": float(f"{np.sqrt(np.mean(distance**2)):.6g}") if len(distance) else None,
        "signs_known": comparison.measured is not None and comparison.measured.knows_outside,
        "calibration_in_sigmas": comparison.knows_calibration,
        "tolerance": None
        if test is None
        else {
            "tolerance": test.tolerance,
            "conformity": test.conformity.value,
            "share_beyond": test.beyond,
            "least_share_beyond": test.least_beyond,
            "most_share_beyond": test.most_beyond,
        },
        "regions": [
            {
                "deviation": region.peak,
                "sigma": region.sigma,
                "across": region.size,
                "area": region.area,
                "volume": region.volume,
                "centre": _numbers(region.centre),
                "direction": _numbers(region.direction),
            }
            for region in comparison.regions
        ],
        "changes": None
        if comparison.changes is None
        else [
            {
                "centre": _numbers(change.centre),
                "across": change.size,
                "area_deviating": change.deviating,
                "area_new": change.new,
                "area_gone": change.gone,
                "deviation": change.peak,
                "sigma": change.sigma,
            }
            for change in comparison.changes
        ],
        "notes": list(comparison.notes),
    }


def alignment_document(name: str, pose: SurfacePose | None) -> dict[str, Any]:
    """A pose of the second surface on the first one, for other programs."""
    if pose is None:
        return {"alignment": name}
    return {
        "alignment": name,
        "rotation": [_numbers(row) for row in pose.pose.rotation],
        "translation": _numbers(pose.pose.translation),
        "scale": pose.scale,
        "overlap": {"reference": pose.overlap[0], "result": pose.overlap[1]},
        "agreeing_share": pose.share,
    } | ({"of_mirror_image": True} if pose.is_mirrored else {})


def _sigmas(covariance: Floats) -> dict[str, Any]:
    sigma = np.sqrt(np.diag(covariance))
    entry: dict[str, Any] = {"rotation_rad": _numbers(sigma[:3]), "shift": _numbers(sigma[3:6])}
    if len(sigma) > 6:
        entry["log_scale"] = float(f"{sigma[6]:.6g}")
    return entry


def _numbers(values: Floats) -> list[float]:
    """Of places and poses in any coordinates: at millions of metres, to a hundredth of a millimetre."""
    return [float(f"{value:.12g}") for value in values]
