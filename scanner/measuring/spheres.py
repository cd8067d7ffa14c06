"""The test with a ball: detection, fit, and the deviations of its points from a sphere."""

from itertools import combinations

import numpy as np

from calib.diagnostics import Budget, LinearFit, Spread, SystematicErrors, footprint_offsets, spread_of_fit, stacked
from calib.finding import FindingKind
from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats, Ints, blocks, robust_sigma
from calib.pointcloud import (
    OrganisedPoints,
    Sphere,
    density,
    find_sphere,
    fit_sphere,
    grid_step,
    image_radius_px,
    index_grid,
)
from calib.refusal import NoMeasurementError
from scanner.measuring.measurements import DistanceMeasurement, FitErrors, SphereMeasurement
from scanner.quantities import percent, shown_unit
from scanner.results import FinishedScan

# Points farther than this share of the radius from the surface belong to other objects.
_GATE = 0.2
# Closer points are outliers beyond this many sigmas. All else counts as the ball's error.
_STRAY_SIGMAS = 10.0
# The part of the ball within this angle of the camera is used: at the rim, a pixel also sees the background.
_FARTHEST_FROM_FACING_DEG = 75.0
_REFITS = 3
# Errors of neighbouring points correlate, as they share patterns. Squares of this many pixels, or of a fifth of the
# ball, count as independent.
_ALIKE_PX, _ALIKE_OF_IMAGE = 8, 0.2
_FEWEST_POINTS = 50
_LEAST_OF_IMAGE = 0.4
_LARGEST_SIZE_ERROR, _LARGEST_SCATTER = 0.15, 0.1

NO_SPHERE = FindingKind(
    "no-sphere",
    "No sphere of the stated diameter was found in the cloud, or it has too few points or another size.",
    "Both devices must see the ball whole and large. Check the diameter (not the radius) and the scale of the result.",
)


def measure_spheres(
    scan: FinishedScan, diameters: list[float], errors: SystematicErrors
) -> tuple[SphereMeasurement, ...]:
    """Fit one sphere for each diameter, in the scan's unit; a diameter given twice finds two spheres. Raises
    NoMeasurementError.
    """
    cloud = _organised(scan)
    density_px = density(cloud.index) * (cloud.camera.width / scan.calibration.camera.width) ** 2
    free = np.ones(len(scan), np.bool_)
    rng = np.random.default_rng(0)
    spheres = []
    for diameter in diameters:
        centre = find_sphere(cloud, diameter / 2, free, rng)
        if centre is None:
            raise _not_found(scan, diameter)
        sphere = _measure(scan, density_px, centre, diameter / 2, errors)
        spheres.append(sphere)
        apart = np.linalg.norm(scan.points - sphere.centre, axis=1)
        free &= apart > (1 + _GATE) * diameter / 2
    return tuple(spheres)


def _organised(scan: FinishedScan) -> OrganisedPoints:
    """The points by the camera's pixels, or by squares of them, as of a coarser camera, if they are few in many."""
    camera = scan.calibration.camera
    step = grid_step(len(scan), camera.size)
    if step > 1:
        camera = Intrinsics(
            -(-camera.width // step),
            -(-camera.height // step),
            (camera.focal_px[0] / step, camera.focal_px[1] / step),
            ((camera.principal_point_px[0] + 0.5) / step - 0.5, (camera.principal_point_px[1] + 0.5) / step - 0.5),
            camera.distortion,
        )
    return OrganisedPoints(scan.points, index_grid(scan.pixel // step, camera.size), camera)


def centre_distances(spheres: tuple[SphereMeasurement, ...]) -> tuple[DistanceMeasurement, ...]:
    """Between the centres of all pairs, as a ball bar is calibrated for."""
    return tuple(
        DistanceMeasurement(
            (f"sphere {i + 1}", f"sphere {j + 1}"),
            np.stack([spheres[i].centre, spheres[j].centre]),
            float(np.linalg.norm(spheres[i].centre - spheres[j].centre)),
            _distance_budget(spheres[i], spheres[j]),
        )
        for i, j in combinations(range(len(spheres)), 2)
    )


def _distance_budget(first: SphereMeasurement, second: SphereMeasurement) -> Budget:
    along = (first.centre - second.centre) / np.linalg.norm(first.centre - second.centre)
    by_parameters = np.array([[*along, 0.0, *-along, 0.0]])
    return stacked([first.spread, second.spread]).through(by_parameters).budget()


def _measure(
    scan: FinishedScan, density_px: float, centre: Floats, radius: float, errors: SystematicErrors
) -> SphereMeasurement:
    """Fit, choose the points again, and so on; then judge whether it is a sphere of that size at all.

    `density_px`: points per camera pixel.
    """
    fitted_centre, fitted_radius = centre, radius
    for _ in range(_REFITS):
        on = _on_ball(scan, fitted_centre, fitted_radius)
        _refuse_few_points(scan, on, density_px, fitted_centre, radius)
        points, rays = scan.points[on], _rays(scan.points[on])
        sphere = fit_sphere(points, _alike(scan, on), fitted_centre, fitted_radius, rays=rays)
        fitted_centre, fitted_radius = sphere.centre, sphere.radius
        _refuse_no_sphere(scan, sphere, radius)
    nominal = fit_sphere(points, _alike(scan, on), sphere.centre, radius, fixed_radius=True, rays=rays)
    stray = np.abs(sphere.residual) > _STRAY_SIGMAS * robust_sigma(sphere.residual)
    pixel = scan.pixel[on][~stray]
    x, y = scan.calibration.camera.project(sphere.centre)
    return SphereMeasurement(
        2 * radius,
        2 * sphere.radius,
        sphere.centre,
        _spread(scan, on, sphere, errors),
        FitErrors(sphere.residual[~stray], pixel),
        FitErrors(nominal.residual[~stray], pixel),
        int(np.count_nonzero(stray)),
        (float(x), float(y), _image_radius(scan, sphere.centre, sphere.radius)),
    )


def _spread(scan: FinishedScan, on: Bools, sphere: Sphere, errors: SystematicErrors) -> Spread:
    points = scan.points[on]
    outwards = (points - sphere.centre) / np.linalg.norm(points - sphere.centre, axis=1, keepdims=True)
    behind = footprint_offsets(sphere, points, float(np.mean(scan.calibration.camera.focal_px)))
    fit = LinearFit(sphere.influence, outwards, sphere.covariance, _alike(scan, on))
    return spread_of_fit(fit, scan.matches[on], errors, -behind)


def _on_ball(scan: FinishedScan, centre: Floats, radius: float) -> Bools:
    """Select points on the ball: their ray passes well inside its outline, and they lie near its surface."""
    ray = _rays(scan.points)
    from_ray = np.linalg.norm(centre - (ray @ centre)[:, None] * ray, axis=1)
    from_centre = np.linalg.norm(scan.points - centre, axis=1)
    inside = from_ray < np.sin(np.radians(_FARTHEST_FROM_FACING_DEG)) * radius
    on: Bools = inside & (np.abs(from_centre - radius) < _GATE * radius)
    return on


def _rays(points: Floats) -> Floats:
    """Unit vectors from the camera to points (N, 3)."""
    rays: Floats = points / np.linalg.norm(points, axis=1, keepdims=True)
    return rays


def _alike(scan: FinishedScan, on: Bools) -> Ints:
    pixel = scan.pixel[on]
    across = float(np.ptp(pixel, axis=0).mean())
    return blocks(pixel, max(1, round(min(_ALIKE_PX, _ALIKE_OF_IMAGE * across))))


def _image_radius(scan: FinishedScan, centre: Floats, radius: float) -> float:
    return float(image_radius_px(scan.calibration.camera, centre[2:], radius)[0])


def _refuse_few_points(scan: FinishedScan, on: Bools, density_px: float, centre: Floats, radius: float) -> None:
    image_px = _image_radius(scan, centre, radius)
    whole = density_px * np.pi * (image_px * np.sin(np.radians(_FARTHEST_FROM_FACING_DEG))) ** 2
    if np.count_nonzero(on) < max(_FEWEST_POINTS, _LEAST_OF_IMAGE * whole):
        raise NoMeasurementError(
            NO_SPHERE,
            f"A sphere was found, but it has {np.count_nonzero(on)} points only, in an image of {2 * image_px:.0f} "
            "pixels across.",
            "Bring the ball closer, put it where both camera and projector see it whole, and scan again.",
        )


def _refuse_no_sphere(scan: FinishedScan, sphere: Sphere, radius: float) -> None:
    size_error = abs(sphere.radius / radius - 1)
    scatter = robust_sigma(sphere.residual) / radius
    if size_error > _LARGEST_SIZE_ERROR or scatter > _LARGEST_SCATTER or not np.isfinite(sphere.radius_sigma):
        unit = shown_unit(scan.unit)
        raise NoMeasurementError(
            NO_SPHERE,
            f"The best candidate for a sphere of {unit.length(2 * radius)} has a diameter of "
            f"{unit.length(2 * sphere.radius)}, and its points scatter by {percent(scatter)} of the radius.",
            "Check the diameter and the scale of the result.",
        )


def _not_found(scan: FinishedScan, diameter: float) -> NoMeasurementError:
    unit = shown_unit(scan.unit)
    largest_px = 2 * _image_radius(scan, np.percentile(scan.points, 1, axis=0), diameter / 2)
    return NoMeasurementError(
        NO_SPHERE,
        f"No sphere with a diameter of {unit.length(diameter)} was found in the cloud, where it would be up to "
        f"{largest_px:.0f} pixels across.",
        "Both devices must see it whole. Check the diameter (not the radius) and the scale of the result.",
    )
