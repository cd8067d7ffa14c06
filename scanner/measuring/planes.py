"""Flatness of the corner's faces, the angles between them, and how well lengths are known: the same for every page."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy

from calib.diagnostics import (
    LinearFit,
    PlaneForm,
    Spread,
    SystematicErrors,
    Uncertainty,
    plane_form,
    spread_of_fit,
    spread_of_vertex,
    stacked,
)
from calib.geometry import Calibration, Matches, Size, intersect
from calib.numerics import Floats, Ints, blocks
from calib.pointcloud import NONE, FittedPlane, dihedral_angle_rad, dihedral_gradients, fit_plane
from scanner.measuring.measurements import (
    AngleMeasurement,
    FaceMeasurement,
    FitErrors,
    MeasuredScene,
    known_lengths,
    rig_errors,
)
from scanner.quantities import FACE_NAMES
from scanner.rendering import cells_over, one_in_cells

# Errors of neighbouring points of a face correlate; squares of this share of the image's width count as independent.
_ALIKE_OF_WIDTH = 1 / 64
_FEWEST_POINTS = 100
# A plane fit to this many points is as accurate as to all, and faster.
_MOST_POINTS = 100_000


def measure_scene(matches: Matches, calibration: Calibration, uncertainty: Uncertainty | None) -> MeasuredScene:
    """Measure the scene from all matches of a scan, or those of `one_in_each_cell`; no faces if they have none."""
    part = one_in_each_cell(matches, calibration.camera.size)
    errors = rig_errors(calibration, uncertainty)
    met = intersect(part, calibration)
    inside = np.all((part.camera_px > -0.5) & (part.camera_px < np.array(calibration.camera.size) - 0.5), axis=1)
    front = np.flatnonzero(met.in_front & inside)
    part, points = part[front], met.points[front]
    labels = () if part.face is None else range(len(FACE_NAMES))
    fitted = [face for label in labels if (face := _fitted(part, points, label, errors)) is not None]
    to_corner = calibration.sigma.known_camera_to_corner
    if to_corner is not None and len(fitted) == len(FACE_NAMES):
        errors = _anchored(fitted, errors, to_corner)
        fitted = [_with_spreads(face, errors) for face in fitted]
    faces = tuple(_measured(face) for face in fitted)
    return MeasuredScene(
        faces, tuple(_angle(*pair) for pair in combinations(fitted, 2)), errors, known_lengths(points, errors)
    )


def one_in_each_cell(matches: Matches, size: Size) -> Matches:
    """All matches of an image of this size, or, if they are more than 100,000, a fixed sample of about as many."""
    if len(matches) <= _MOST_POINTS:
        return matches
    drawn = one_in_cells(matches.camera_px, *sample_cells(size))
    return matches[np.asarray(drawn[drawn != NONE])]


def sample_cells(size: Size) -> tuple[int, int, int]:
    """The cells of that sample over an image: their side in pixels, rows, and columns."""
    return cells_over(size, _MOST_POINTS)


@dataclass(frozen=True)
class _Face:
    """A face with its matches, whose errors are equal within each `cluster` (N,); the `spread` of its plane's
    parameters, and that of its form.
    """

    label: int
    matches: Matches
    plane: FittedPlane
    form: PlaneForm
    cluster: Ints
    spread: Spread
    spread_of_form: Spread


def _fitted(matches: Matches, points: Floats, label: int, errors: SystematicErrors) -> _Face | None:
    on = np.flatnonzero(matches.face == label)
    if len(on) < _FEWEST_POINTS:
        return None
    of_face = matches[on]
    cluster = blocks(_pixels(of_face), max(1, round(errors.calibration.camera.width * _ALIKE_OF_WIDTH)))
    plane = fit_plane(points[on], cluster)
    form = plane_form(plane, of_face.camera_px, cluster)
    return _Face(label, of_face, plane, form, cluster, *_spreads(plane, form, cluster, of_face, errors))


def _with_spreads(face: _Face, errors: SystematicErrors) -> _Face:
    spread, of_form = _spreads(face.plane, face.form, face.cluster, face.matches, errors)
    return replace(face, spread=spread, spread_of_form=of_form)


def _spreads(
    plane: FittedPlane, form: PlaneForm, cluster: Ints, matches: Matches, errors: SystematicErrors
) -> tuple[Spread, Spread]:
    """Of the plane's parameters, and of its form's: what moves the points is the same for both, and takes long."""
    direction = np.broadcast_to(plane.normal, (len(matches), 3))
    of_plane = plane.influence
    influence = np.concatenate([of_plane, form.influence])
    both = spread_of_fit(
        LinearFit(influence, direction, scipy.linalg.block_diag(plane.covariance, form.covariance), cluster),
        matches,
        errors,
    )
    count = len(of_plane)
    return both.part(slice(count)), both.part(slice(count, None))


def _measured(face: _Face) -> FaceMeasurement:
    return FaceMeasurement(
        FACE_NAMES[face.label],
        face.plane.normal,
        face.plane.offset,
        FitErrors(face.plane.residual, _pixels(face.matches)),
        face.form.deviation,
        face.spread_of_form.total(),
    )


def _pixels(matches: Matches) -> Ints:
    return np.rint(matches.camera_px).astype(np.int64)


def _anchored(faces: list[_Face], errors: SystematicErrors, sigma: float) -> SystematicErrors:
    """The errors where the known length is the distance to the faces' vertex."""
    vertex, spread = spread_of_vertex([face.plane for face in faces], [face.spread for face in faces])
    length = float(np.linalg.norm(vertex))
    return errors.anchored(spread.through(vertex[None] / length), length, sigma / length)


def _angle(first: _Face, second: _Face) -> AngleMeasurement:
    angle_rad, _ = dihedral_angle_rad(first.plane, second.plane)
    gradient = np.concatenate(dihedral_gradients(first.plane, second.plane))[None]
    spread = stacked([first.spread, second.spread]).through(np.degrees(gradient))
    names = (FACE_NAMES[first.label], FACE_NAMES[second.label])
    return AngleMeasurement(names, float(np.degrees(angle_rad)), spread.budget())
