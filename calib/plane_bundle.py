"""All planes at once: one epipolar geometry and two lenses that explain the surfels on every plane."""

import numpy as np

from calib.arrays import Floats, Ints
from calib.homography import homogeneous
from calib.robust import minimise
from calib.surfels import Surfels
from calib.two_view import CAMERA_SIGMA, PROJECTOR_SIGMA, TwoView

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
    camera_px, projector_px, label = surfels.camera_px[chosen], surfels.projector_px[chosen], label[chosen]
    count, scale = len(planes), view.projector.unit_px / tolerance_px

    def unpack(parameters: Floats) -> tuple[TwoView, Floats]:
        return TwoView(
            view.camera.with_parameters(parameters[:4]),
            view.projector.with_parameters(parameters[4:8]),
            parameters[8:17].reshape(3, 3),
            parameters[17:20],
        ), parameters[20:].reshape(count, 3)

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        trial, v = unpack(parameters)
        x = homogeneous(trial.camera.ideal(camera_px))
        parallax = np.sum(x * v[label], axis=1)
        predicted = x @ trial.base.T + parallax[:, None] * trial.epipole
        point = predicted[:, :2] / predicted[:, 2:]
        # Of the point with respect to the homogeneous prediction, (N, 2, 3).
        by_predicted = np.concatenate([np.broadcast_to(np.eye(2), (len(x), 2, 2)), -point[:, :, None]], axis=2)
        by_predicted = by_predicted / predicted[:, 2, None, None]
        by_x = by_predicted @ trial.homography(v)[label]
        by_parallax = by_predicted @ trial.epipole
        by_plane = np.zeros((len(x), 2, count, 3))
        by_plane[np.arange(len(x)), :, label] = by_parallax[:, :, None] * x[:, None, :]
        jacobian = np.concatenate(
            [
                by_x[:, :, :2] @ trial.camera.jacobian(camera_px),
                -trial.projector.jacobian(projector_px),
                (by_predicted[:, :, :, None] * x[:, None, None, :]).reshape(-1, 2, 9),
                by_predicted * parallax[:, None, None],
                by_plane.reshape(-1, 2, 3 * count),
            ],
            axis=2,
        )
        return (point - trial.projector.ideal(projector_px)) * scale, jacobian * scale

    start = np.concatenate(
        [view.camera.parameters, view.projector.parameters, view.base.ravel(), view.epipole, planes.ravel()]
    )
    sigma = np.array([*CAMERA_SIGMA, *PROJECTOR_SIGMA] + [np.inf] * (12 + 3 * count))
    return unpack(minimise(evaluate, start, sigma)[0])
