"""All planes at once: one epipolar geometry and two lenses that explain the surfels on every plane."""

from collections.abc import Callable

import numpy as np

from calib.numerics import Floats, Ints, compiled, minimise
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
    return _unpack(minimise(evaluate, start, sigma)[0], view)


def residuals_of_planes(
    camera_px: Floats, projector_px: Floats, label: Ints, view: TwoView, planes: Floats, tolerance_px: float
) -> tuple[Callable[[Floats], tuple[Floats, Floats]], Floats]:
    """What gives, for lenses, geometry and planes (P,), the residuals (N, 2) of matches (N, 2) and their Jacobian
    (N, 2, P); and those of `view` and `planes` (n, 3). `label` (N,): the plane of each match.
    """
    start = np.concatenate(
        [view.camera.parameters, view.projector.parameters, view.base.ravel(), view.epipole, planes.ravel()]
    )
    scale = view.projector.unit_px / tolerance_px
    residual, jacobian = np.empty((2, len(label))).T, np.zeros((len(start), 2, len(label))).T

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        trial, v = _unpack(parameters, view)
        _off_planes(
            trial.camera.ideal(camera_px),
            trial.projector.ideal(projector_px),
            trial.camera.jacobian(camera_px),
            trial.projector.jacobian(projector_px),
            label,
            trial.homography(v),
            trial.epipole,
            v,
            scale,
            residual,
            jacobian,
        )
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
def _off_planes(
    x: Floats,
    u: Floats,
    x_by_lens: Floats,
    u_by_lens: Floats,
    label: Ints,
    homographies: Floats,
    epipole: Floats,
    planes: Floats,
    scale: float,
    residual: Floats,
    jacobian: Floats,
) -> None:
    """`residual` (N, 2), `jacobian` (N, 2, 20 + 3 n) of u = (A + e vᵀ) x in units of 1 / `scale`: by both lenses, A, e
    and the planes v. What a match has with other planes than its own is left as it is, zero.
    """
    for i in range(len(x)):
        h, v, own = homographies[label[i]], planes[label[i]], 20 + 3 * label[i]
        parallax = v[0] * x[i, 0] + v[1] * x[i, 1] + v[2]
        third = h[2, 0] * x[i, 0] + h[2, 1] * x[i, 1] + h[2, 2]
        per_third = scale / third
        for d in range(2):
            point = (h[d, 0] * x[i, 0] + h[d, 1] * x[i, 1] + h[d, 2]) / third
            residual[i, d] = (point - u[i, d]) * scale
            row = jacobian[i, d]
            by_x0, by_x1 = (h[d, 0] - point * h[2, 0]) * per_third, (h[d, 1] - point * h[2, 1]) * per_third
            for k in range(4):
                row[k] = by_x0 * x_by_lens[i, 0, k] + by_x1 * x_by_lens[i, 1, k]
                row[4 + k] = -u_by_lens[i, d, k] * scale
            first = 8 + 3 * d
            row[first], row[first + 1], row[first + 2] = x[i, 0] * per_third, x[i, 1] * per_third, per_third
            row[14], row[15], row[16] = -point * row[first], -point * row[first + 1], -point * per_third
            row[17 + d], row[19] = parallax * per_third, -point * parallax * per_third
            by_parallax = (epipole[d] - point * epipole[2]) * per_third
            row[own], row[own + 1], row[own + 2] = by_parallax * x[i, 0], by_parallax * x[i, 1], by_parallax
