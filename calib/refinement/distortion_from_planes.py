"""How much both lenses bend, from the straightness of planes alone, before anything else is known.

What a homography through ideal pixels cannot explain on any of the planes is the lenses' doing. Lenses that are left in
bend the picture of a corner so much that it may not look like one.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import FACES, Matches, homography_between, project, unproject
from calib.numerics import Floats
from calib.refinement.match_cells import Cells

# Beforehand, of the bend in units of an image's width: that of a lens with k1 = 0.1 and a focal length of half a width.
_SIGMA = 0.4
_STEPS = 30
_DAMPING, _LEAST_DAMPING = 1e-6, 1e-9  # of the normal matrix's diagonal; the homographies' scales need some
_CONVERGED = 1e-10  # of the cost


@dataclass(frozen=True)
class Straightened:
    """`matches`: cells on the faces with the bend removed from both sides; `camera_bend`, `projector_bend`: k1 / f²,
    per squared pixel.
    """

    matches: Matches
    camera_bend: float
    projector_bend: float


def straighten(
    cells: Cells, camera_centre_px: tuple[float, float], projector_centre_px: tuple[float, float]
) -> Straightened:
    """Remove one radial term on each side, around the given centres, that makes the faces' homographies straight."""
    faces = cells[cells.plane < len(FACES)]
    camera, projector = (_nominal(centre) for centre in (camera_centre_px, projector_centre_px))
    parameters = np.concatenate([_homographies(faces, camera, projector).ravel(), np.zeros(2)])
    damping = _DAMPING
    cost, normal, slope = _misfit(faces, camera, projector, parameters)
    for _ in range(_STEPS):
        step = np.linalg.solve(normal + damping * np.diag(np.maximum(np.diag(normal), 1.0)), -slope)
        if -slope @ step < _CONVERGED * cost:
            break
        trial = _misfit(faces, camera, projector, parameters + step)
        if trial[0] < cost:
            parameters, (cost, normal, slope) = parameters + step, trial
            damping = max(damping / 10, _LEAST_DAMPING)
        else:
            damping *= 10
    camera[3], projector[3] = parameters[-2:]
    ideal = [
        unproject(device, pixels)[0][:, :2] * device[0] + device[1:3]
        for device, pixels in ((camera, faces.camera_px), (projector, faces.projector_px))
    ]
    return Straightened(
        Matches(ideal[0], ideal[1], faces.plane), camera[3] / camera[0] ** 2, projector[3] / projector[0] ** 2
    )


def _nominal(centre_px: tuple[float, float]) -> Floats:
    """A device whose focal length is its width, about twice its centre, without bend."""
    return np.array([2 * centre_px[0] + 1, *centre_px, 0.0, 0.0])


def _homographies(cells: Cells, camera: Floats, projector: Floats) -> Floats:
    """From ideal ray to ideal ray, (3, 3, 3), without bend."""
    homographies = []
    for face in FACES:
        on_face = cells.plane == face
        source = (cells.camera_px[on_face] - camera[1:3]) / camera[0]
        target = (cells.projector_px[on_face] - projector[1:3]) / projector[0]
        homography = homography_between(source, target)
        homographies.append(homography / np.linalg.norm(homography))
    return np.stack(homographies)


def _misfit(cells: Cells, camera: Floats, projector: Floats, parameters: Floats) -> tuple[float, Floats, Floats]:
    """Sum of squared deviations in sigmas, the normal matrix (29, 29) and half the gradient (29,), with the prior.

    `parameters` (29,): the homographies row by row, the camera's and the projector's bend.
    """
    camera, projector = camera.copy(), projector.copy()
    camera[3], projector[3] = parameters[-2:]
    rays, by_camera = unproject(camera, cells.camera_px)
    mapped = np.einsum("nij,nj->ni", parameters[:-2].reshape(3, 3, 3)[cells.plane], rays)
    pixels, by_point, by_projector = project(projector, mapped)
    by_bend = np.einsum("nij,njk,nk->ni", by_point, parameters[:-2].reshape(3, 3, 3)[cells.plane], by_camera[:, :, 3])

    normal, slope = np.zeros((len(parameters), len(parameters))), np.zeros(len(parameters))
    normal[-2:, -2:] = np.eye(2) / _SIGMA**2
    slope[-2:] = parameters[-2:] / _SIGMA**2
    cost = float(np.sum((parameters[-2:] / _SIGMA) ** 2))
    for face in FACES:
        on_face = cells.plane == face
        columns = np.array([*range(9 * face, 9 * face + 9), len(parameters) - 2, len(parameters) - 1])
        by_homography = (by_point[on_face, :, :, None] * rays[on_face, None, None, :]).reshape(-1, 2, 9)
        bends = np.stack([by_bend[on_face], by_projector[on_face, :, 3]], axis=2)
        sigma = cells.sigma_px[on_face, None]
        derivatives = (np.concatenate([by_homography, bends], axis=2) / sigma[:, :, None]).reshape(-1, len(columns))
        residual = ((pixels[on_face] - cells.projector_px[on_face]) / sigma).ravel()
        normal[np.ix_(columns, columns)] += derivatives.T @ derivatives
        slope[columns] += derivatives.T @ residual
        cost += float(residual @ residual)
    return cost, normal, slope
