"""Planar bundle adjustment: one epipolar geometry and two lenses for the surfels on all planes at once."""

from collections.abc import Callable

import numpy as np

from calib.numerics import Floats, Ints, compiled, minimise
from calib.plane_segmentation.fundamental_matrix import off_homographies
from calib.plane_segmentation.plane_parallax import CAMERA_SIGMA, LENS_TERMS, PROJECTOR_SIGMA, TwoView
from calib.plane_segmentation.surfels import Surfels

_PER_PLANE = 300


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
