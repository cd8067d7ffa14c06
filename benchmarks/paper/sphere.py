"""Figure 7: a ball beside the corner that calibrated the rig, fitted in the clouds of several calibrations.

It is the ball of the simulated room. A scaled scene gives the same images, so lengths are scaled to the diameter of the
paper's ball. The ball takes no part in any calibration.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from colmap_two_view import HAS_COLMAP

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats
from calib.pointcloud import fit_sphere
from calib.refusal import RefusalError
from hw.simulated import Label, place_room
from paper.captures import Captured, Setup, captured, settings_of, thinned, without_distortion
from paper.colmap import MATCHES, centre_start, paper_start, variants
from paper.experiment import Experiment, Figures, room_of, rooms
from paper.methods import by_paper, known_point, refined
from paper.plots import NO_POINT
from paper.published import SPHERE_MM

CELLS = 40  # cells of a heat map across the ball
# At the rim, a pixel also sees the background.
FACING_DEG = 70.0
_STRAY = 0.2  # share of the radius: farther matches are on something else


def _measure(setup: Setup, part: str) -> Figures:
    room = room_of(part)
    capture = captured(setup, room)
    ball = place_room(settings_of(room), setup.camera_size, setup.projector_size).scene.sphere
    assert ball is not None
    mm = SPHERE_MM / 2 / ball.radius  # per metre of the simulated room
    on_ball = _facing(capture, setup, room)
    figures: Figures = {"points": len(on_ball), "metres_to_mm": mm, "methods": {}}
    for name, calibrate in _calibrations(capture, room).items():
        try:
            calibration = calibrate()
        except RefusalError:
            calibration = None
        fitted = None if calibration is None else _fit(on_ball, calibration, capture.truth.baseline * mm)
        if fitted is not None and room != setup.rooms[0]:
            del fitted["map_um"]
        figures["methods"][name] = fitted
    return figures


def _facing(capture: Captured, setup: Setup, room: int) -> Matches:
    """Matches on the part of the ball that faces the camera."""
    placed = place_room(settings_of(room), setup.camera_size, setup.projector_size)
    assert placed.scene.sphere is not None
    centre = placed.camera.rotation @ (placed.scene.sphere.centre - placed.camera.centre)
    of_ball = capture.matches[capture.true_label == Label.SPHERE]
    rays = capture.truth.camera.unproject(of_ball.camera_px)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    aside = np.linalg.norm(centre - (rays @ centre)[:, None] * rays, axis=1)
    return of_ball[aside < np.sin(np.radians(FACING_DEG)) * placed.scene.sphere.radius]


def _calibrations(capture: Captured, room: int) -> dict[str, Callable[[], Calibration | None]]:
    truth, masked = capture.truth, capture.with_true_faces
    few = thinned(masked, MATCHES, room)
    of_colmap: dict[str, Callable[[], Calibration | None]] = {
        "C-BA": lambda: variants(few, truth, centre_start(truth))[1],
        "R-BA": lambda: variants(few, truth, paper_start(truth))[1],
    }
    return {
        "true calibration": lambda: truth,
        **(of_colmap if HAS_COLMAP else {}),
        "paper": lambda: by_paper(masked, truth),
        "paper, lenses corrected": lambda: _with_lenses(by_paper(without_distortion(masked, truth), truth), truth),
        "refined": lambda: refined([capture.matches], truth, known_point(truth)),
    }


def _with_lenses(found: Calibration, truth: Calibration) -> Calibration:
    """A calibration from corrected matches, for uncorrected ones: with the lenses of the correction."""
    return replace(
        found,
        camera=replace(found.camera, distortion=truth.camera.distortion),
        projector=replace(found.projector, distortion=truth.projector.distortion),
    )


def _fit(on_ball: Matches, calibration: Calibration, baseline_mm: float) -> Figures | None:
    """Errors of the fit in mm with the true baseline; None if the points are no ball.

    `mean_absolute_mm` concerns the shape only: the cloud is scaled so that its ball has the true diameter.
    """
    met = intersect(on_ball, calibration)
    ahead = met.in_front
    if ahead.mean() < 0.5:
        return None
    points, pixels = met.points[ahead] * (baseline_mm / calibration.baseline), on_ball.camera_px[ahead]
    centre, radius = _start(points)
    near = np.abs(np.linalg.norm(points - centre, axis=1) - radius) < _STRAY * radius
    if near.sum() < 4:
        return None
    one_cluster = np.zeros(int(near.sum()), np.int64)
    sphere = fit_sphere(points[near], one_cluster, centre, radius)
    to_size = SPHERE_MM / 2 / sphere.radius
    residual = sphere.residual * to_size
    return {
        "mean_absolute_mm": float(np.abs(residual).mean()),
        "diameter_error_mm": 2 * sphere.radius - SPHERE_MM,
        "share_of_points": float(near.sum() / len(on_ball)),
        "map_um": _heat_map(pixels[near], residual),
    }


def _start(points: Floats) -> tuple[Floats, float]:
    """Algebraic least squares: |X|² = 2 X·c + (r² − |c|²)."""
    middle = np.median(points, axis=0)
    scale = float(np.median(np.linalg.norm(points - middle, axis=1)))
    unit = (points - middle) / scale
    solved = np.linalg.lstsq(np.column_stack([2 * unit, np.ones(len(unit))]), np.sum(unit**2, axis=1), rcond=None)[0]
    radius = np.sqrt(max(solved[3] + solved[:3] @ solved[:3], 1e-6))
    return middle + scale * solved[:3], float(scale * radius)


def _heat_map(pixels: Floats, residual_mm: Floats) -> list[str]:
    """Means of the signed distances in µm over the cells of the ball's image, row by row; NO_POINT for empty cells."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    cell = np.minimum((CELLS * (pixels - low) / (high - low).max()).astype(int), CELLS - 1)
    index = cell[:, 1] * CELLS + cell[:, 0]
    count = np.bincount(index, minlength=CELLS**2).reshape(CELLS, CELLS)
    total = np.bincount(index, 1000 * residual_mm, CELLS**2).reshape(CELLS, CELLS)
    cells = [f"{t / n:.0f}" if n else NO_POINT for t, n in zip(total.flat, count.flat, strict=True)]
    return [" ".join(cells[row : row + CELLS]) for row in range(0, CELLS**2, CELLS)]


SPHERE = Experiment("figure7", rooms, _measure)
