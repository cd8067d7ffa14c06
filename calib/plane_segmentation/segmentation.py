"""Surfels → planes of one scene, with the epipolar geometry and the lenses that they share.

Planes are extracted one after the other; the parallax of a plane is an affine function of the image.

Planar bundle adjustment: one epipolar geometry and two lenses for the surfels on all planes at once.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.numerics import Floats, Ints, compiled, minimise
from calib.plane_segmentation.fundamental_matrix import first_geometry, largest_plane, off_homographies
from calib.plane_segmentation.plane_parallax import CAMERA_SIGMA, LENS_TERMS, PROJECTOR_SIGMA, TwoView
from calib.plane_segmentation.region_growing import grow, local_planes
from calib.plane_segmentation.surfels import SurfelEquations, Surfels, gather_evidence

_PER_PLANE = 300
NO_PLANE = -1
_SEEDS = 80
_GATE, _GATE_3D = 3.5, 4.5  # in sigmas: for one number, and for the norm of three
_MOST_PLANES = 16
# A plane that holds fewer surfels than this, or this share of all, is of no use to a calibration.
_FEWEST_SURFELS, _LEAST_SHARE = 12, 0.004
# The standard deviation, in sigmas, of errors that fill the gate evenly is 2.
_MOST_SCATTER = 1.3
_CLOSE = 15.0


def refine(
    surfels: Surfels, label: Ints, view: TwoView, planes: Floats, tolerance_px: float, rng: np.random.Generator
) -> tuple[TwoView, Floats]:
    """Maximum-likelihood geometry, lenses and planes (n, 3) from the surfels with a `label` (M,) 0 … n − 1.

    Surfels off by more than `tolerance_px` lose influence.
    """
    chosen = np.concatenate(
        [rng.permutation(np.flatnonzero(label == plane))[:_PER_PLANE] for plane in range(len(planes))]
    )
    evaluate, start = residuals_of_planes(
        surfels.camera_px[chosen], surfels.projector_px[chosen], label[chosen], view, planes, tolerance_px
    )
    sigma = np.array([*CAMERA_SIGMA, *PROJECTOR_SIGMA] + [np.inf] * (len(start) - 2 * LENS_TERMS))
    return _unpack(minimise(evaluate, start, sigma).parameters, view)


def residuals_of_planes(
    camera_px: Floats, projector_px: Floats, label: Ints, view: TwoView, planes: Floats, tolerance_px: float
) -> tuple[Callable[[Floats], tuple[Floats, Floats]], Floats]:
    """Return a function from lenses, geometry and planes (P,) to the residuals (N, 2) of matches and their Jacobian
    (N, 2, P), and the parameters (P,) of `view` and `planes` (n, 3). `label` (N,): the plane of each match.
    """
    start = np.concatenate(
        [view.camera.parameters, view.projector.parameters, view.base.ravel(), view.epipole, planes.ravel()]
    )
    scale = view.projector.unit_px / tolerance_px
    residual, jacobian = np.empty((2, len(label))).T, np.zeros((len(start), 2, len(label))).T

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        trial, v = _unpack(parameters, view)
        x, u = trial.camera.ideal(camera_px), trial.projector.ideal(projector_px)
        by_lenses = trial.camera.jacobian(camera_px), trial.projector.jacobian(projector_px)
        off_homographies(x, u, *by_lenses, trial.homography(v), label, scale, residual, jacobian)
        _by_planes(jacobian, label, trial.epipole, v)
        return residual, jacobian

    return evaluate, start


def _unpack(parameters: Floats, view: TwoView) -> tuple[TwoView, Floats]:
    trial = TwoView(
        view.camera.with_parameters(parameters[:4]),
        view.projector.with_parameters(parameters[4:8]),
        parameters[8:17].reshape(3, 3),
        parameters[17:20],
    )
    return trial, parameters[20:].reshape(-1, 3)


@compiled
def _by_planes(jacobian: Floats, label: Ints, epipole: Floats, planes: Floats) -> None:
    """Fill in the derivatives by e and the planes v from those by H = A + e vᵀ, which are also those by A.

    The derivatives by planes other than the match's own stay zero.
    """
    for i in range(len(label)):
        v, own = planes[label[i]], 20 + 3 * label[i]
        for d in range(2):
            row = jacobian[i, d]
            for k in range(3):
                row[17 + k] = row[8 + 3 * k] * v[0] + row[9 + 3 * k] * v[1] + row[10 + 3 * k] * v[2]
                row[own + k] = row[8 + k] * epipole[0] + row[11 + k] * epipole[1] + row[14 + k] * epipole[2]


def find_planes(surfels: Surfels, evidence: SurfelEquations, rng: np.random.Generator) -> tuple[Floats, Ints]:
    """Return planes (n, 3), largest first, and the plane of each surfel (M,), NO_PLANE for none."""
    seeds, covariance, usable = local_planes(surfels, evidence.rows, _GATE)
    fewest = _fewest(len(surfels))
    across = np.abs(evidence.across)
    free = across < _GATE + 3 * np.median(across * evidence.sigma) / evidence.sigma
    planes: list[Floats] = []
    while len(planes) < _MOST_PLANES and np.any(free & usable):
        pool = np.flatnonzero(free & usable)
        picked = pool[rng.permutation(len(pool))[:_SEEDS]]
        remaining = np.flatnonzero(free)
        plane, inlier = grow(evidence.rows.take(remaining, axis=1), seeds[picked], covariance[picked], _GATE)
        if np.count_nonzero(inlier) < fewest:
            usable[picked] = False
            continue
        planes.append(plane)
        free[remaining[inlier]] = False
    if not planes:
        return np.empty((0, 3)), np.full(len(surfels), NO_PLANE, np.int32)
    return _assign(surfels, evidence, np.stack(planes))


def _fewest(surfels: int) -> int:
    return max(_FEWEST_SURFELS, round(_LEAST_SHARE * surfels))


def _assign(surfels: Surfels, evidence: SurfelEquations, planes: Floats) -> tuple[Floats, Ints]:
    """Assign each surfel to its best plane; drop planes and components with too few. Returns as `find_planes`."""
    fewest, error = _fewest(len(surfels)), _errors(evidence, planes)
    while True:
        label = np.argmin(error, axis=0).astype(np.int32)
        label[error.min(axis=0) > 1] = NO_PLANE
        label = _without_islands(surfels, label, len(planes))
        counts = np.bincount(label[label >= 0], minlength=len(planes))
        if counts.min() >= fewest:
            break
        # Drop the smallest first: its surfels may complete another plane.
        smallest = np.argmin(counts)
        planes, error = np.delete(planes, smallest, axis=0), np.delete(error, smallest, axis=0)
        if len(planes) == 0:
            return planes, np.full(len(surfels), NO_PLANE, np.int32)
    order = np.argsort(-counts, kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    return planes[order], np.where(label >= 0, rank[label], NO_PLANE).astype(np.int32)


def without_uneven(evidence: SurfelEquations, planes: Floats, label: Ints) -> tuple[Floats, Ints, float]:
    """Drop planes whose surfels scatter over the whole tolerance: patches of a curved or bumpy surface that end where
    the surface leaves the tolerance. Also return the share of surfels on the largest dropped plane.
    """
    if len(planes) == 0:
        return planes, label, 0.0
    error = evidence.off_own(planes, label)
    kept = [plane for plane in range(len(planes)) if np.std(error[label == plane]) < _MOST_SCATTER]
    renumbered = np.full(len(planes) + 1, NO_PLANE, np.int32)
    renumbered[kept] = np.arange(len(kept))
    dropped = [float(np.mean(label == plane)) for plane in range(len(planes)) if plane not in kept]
    return planes[kept], renumbered[label], max(dropped, default=0.0)


def covariances(evidence: SurfelEquations, label: Ints, planes: int) -> Floats:
    """Return the covariance of each plane (n, 3, 3) from the surfels on it."""
    information = np.zeros((planes, 3, 3))
    for plane in range(planes):
        x = evidence.rows[1:4, label == plane]
        information[plane] = x @ x.T
    # Large instead of infinite along what surfels in one line leave open.
    ridge = 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.linalg.inv(information + ridge)


def spill(evidence: SurfelEquations, planes: Floats, label: Ints) -> float:
    """Return the number of surfels close to but not on the three largest planes, relative to those on them.

    Nearly zero for planes; more than half if the tolerance cuts uneven surfaces into slices; infinite without planes.
    """
    if len(planes) == 0:
        return np.inf
    largest = np.argsort(-np.bincount(label[label >= 0], minlength=len(planes)), kind="stable")[:3]
    error = np.abs(evidence.off(planes[largest]))
    close = int(np.count_nonzero((error < _CLOSE) & (label != largest[:, None])))
    return close / max(1, int(np.count_nonzero(np.isin(label, largest))))


def _errors(evidence: SurfelEquations, planes: Floats) -> Floats:
    """Return the squared error of each surfel for each plane (n, M), summed over its three numbers, over the gate's."""
    value, slope_x, slope_y = (evidence.off(planes, number) ** 2 for number in range(3))
    return (value + slope_x + slope_y) / _GATE_3D**2


def _without_islands(surfels: Surfels, label: Ints, planes: int) -> Ints:
    """Remove labels of connected components of fewer than four cells: chance agreements, as along a crease."""
    grid = surfels.grid
    kept = label.copy()
    for plane in range(planes):
        image = np.zeros(grid.rows * grid.columns, np.uint8)
        image[surfels.cell[label == plane]] = 1
        _, component, stats, _ = cv2.connectedComponentsWithStats(image.reshape(grid.rows, grid.columns))
        small = stats[:, cv2.CC_STAT_AREA] < 4
        kept[(label == plane) & small[component.ravel()[surfels.cell]]] = NO_PLANE
    return kept


# Initial standard deviations of the errors of lens model, decoder and uneven walls: the first that explains whole
# surfaces is used, and then replaced by the measured one.
_FIRST_MODELS_PX = (0.15, 0.6, 2.4)
_LEAST_MODEL_PX = 0.05
_MOST_SPILL = 0.25
# So much of a picture is a face that was dropped for being uneven: behind a lens out of focus dark ones are noisier.
_MUCH_UNEVEN = 0.1


@dataclass(frozen=True)
class Segments:
    """`planes` (n, 3), largest first, and their `covariance` (n, 3, 3); `label` (M,): the plane of each surfel;
    `model_px`: standard deviation of the surfels about their planes beyond their noise; `spill` and `uneven`, the
    largest share of the surfels that lay on a plane which was dropped, as in plane_extraction.py.
    """

    view: TwoView
    planes: Floats
    covariance: Floats
    label: Ints
    model_px: float
    spill: float
    uneven: float

    def about(self, point: tuple[float, float]) -> "Segments":
        """The same planes of ideal camera coordinates that have their origin at this point."""
        from_point = np.array([[1.0, 0.0, point[0]], [0.0, 1.0, point[1]], [0.0, 0.0, 1.0]])
        return replace(
            self,
            view=replace(self.view, base=self.view.base @ from_point),
            planes=self.planes @ from_point,
            covariance=from_point.T @ self.covariance @ from_point,
        )


def segmentations(
    surfels: Surfels, camera_size: tuple[int, int], projector_size: tuple[int, int], rng: np.random.Generator
) -> Iterator[Segments]:
    """Yield the planes at the tightest tolerance that does not cut surfaces into slices, or that does so least.

    Then, in case these form no corner, yield those at each wider tolerance, as long as the previous one dropped a large
    plane as uneven.
    """
    view = first_geometry(surfels, largest_plane(surfels, camera_size, projector_size, rng), rng)
    candidates: list[Segments] = []
    models_px = iter(_FIRST_MODELS_PX)
    for model_px in models_px:
        candidates.append(_segment_within(surfels, view, model_px, rng))
        if candidates[-1].spill < _MOST_SPILL:
            break
    last = min(candidates, key=lambda segments: segments.spill)
    yield last
    for model_px in models_px:
        if last.uneven < _MUCH_UNEVEN:
            return
        last = _segment_within(surfels, view, model_px, rng)
        yield last


def _segment_within(surfels: Surfels, view: TwoView, model_px: float, rng: np.random.Generator) -> Segments:
    evidence = gather_evidence(surfels, view, model_px)
    planes, label = find_planes(surfels, evidence, rng)
    if len(planes) > 0:
        # With both lenses refined on the planes, the tolerance can be tight enough to separate nearly coplanar planes.
        view, planes = refine(surfels, label, view, planes, 2 * model_px, rng)
        evidence = gather_evidence(surfels, view, model_px)
        off_px = np.abs(evidence.off_own(planes, label) * evidence.sigma)[label >= 0]
        model_px = max(_LEAST_MODEL_PX, 1.5 * float(np.median(off_px)))
        evidence = gather_evidence(surfels, view, model_px)
        planes, label = find_planes(surfels, evidence, rng)
    sliced = spill(evidence, planes, label)
    planes, label, uneven = without_uneven(evidence, planes, label)
    if len(planes) > 0:
        view, planes = refine(surfels, label, view, planes, 2 * model_px, rng)
        evidence = gather_evidence(surfels, view, model_px)
    return Segments(view, planes, covariances(evidence, label, len(planes)), label, model_px, sliced, uneven)
