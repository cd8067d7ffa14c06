"""Estimate the radial distortion of both lenses from planes alone, before anything else is known.

A plane's matches follow a homography between ideal pixels; deviations common to all planes are lens distortion.
Uncorrected distortion can bend the image of a corner so much that it no longer looks like one.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.estimation import Cells
from calib.geometry import FACES, Matches, homography_between, project, unproject
from calib.numerics import Damping, Floats, minimise
from calib.refinement.parameters import without_lens

# Prior sigma of the bend, in units of the image width: a lens with k1 = 0.1 and a focal length of half a width.
_SIGMA = 0.4
_STRAIGHT = 1e-9  # of lenses that have no bend
_STEPS = 30
_DAMPING = Damping(first=1e-6, least=1e-9, most=1e12, growth=10.0, relief=0.1)  # the homographies' scales are a gauge
_CONVERGED = 1e-10  # relative to the cost


@dataclass(frozen=True)
class Straightened:
    """`matches`: cells on the faces with the bend removed from both sides; `camera_bend`, `projector_bend`: k1 / f²,
    per squared pixel.
    """

    matches: Matches
    camera_bend: float
    projector_bend: float


def straighten(
    cells: Cells,
    camera_centre_px: tuple[float, float],
    projector_centre_px: tuple[float, float],
    bent: tuple[bool, bool] = (True, True),
) -> Straightened:
    """Remove one radial term per device, around the given centres, so that each face follows a homography.

    `bent`: whether camera and projector may have one.
    """
    faces = cells[cells.plane < len(FACES)]
    camera, projector = (_nominal(centre) for centre in (camera_centre_px, projector_centre_px))
    start = np.concatenate([_homographies(faces, camera, projector).ravel(), np.zeros(2)])
    prior_sigma = np.append(np.full(len(start) - 2, np.inf), [_SIGMA if may else _STRAIGHT for may in bent])
    misfit = partial(_misfit, faces, camera, projector)
    fit = minimise(
        misfit, start, prior_sigma, robust=False, damping=_DAMPING, converged=_CONVERGED, least_gain=0.0, steps=_STEPS
    )
    camera[3], projector[3] = fit.parameters[-2:]
    ideal = [
        unproject(device, pixels)[0][:, :2] * device[0] + device[1:3]
        for device, pixels in ((camera, faces.camera_px), (projector, faces.projector_px))
    ]
    return Straightened(
        Matches(ideal[0], ideal[1], faces.plane), camera[3] / camera[0] ** 2, projector[3] / projector[0] ** 2
    )


def _nominal(centre_px: tuple[float, float]) -> Floats:
    """Return a device without distortion whose focal length is its image width, about twice its centre."""
    return without_lens(2 * centre_px[0] + 1, np.array(centre_px))


def _homographies(cells: Cells, camera: Floats, projector: Floats) -> Floats:
    """Fit the homographies (3, 3, 3) between rays of devices without distortion."""
    homographies = []
    for face in FACES:
        on_face = cells.plane == face
        source = (cells.camera_px[on_face] - camera[1:3]) / camera[0]
        target = (cells.projector_px[on_face] - projector[1:3]) / projector[0]
        homography = homography_between(source, target)
        homographies.append(homography / np.linalg.norm(homography))
    return np.stack(homographies)


def _misfit(cells: Cells, camera: Floats, projector: Floats, parameters: Floats) -> tuple[Floats, Floats]:
    """Deviations (N, 2) in sigmas, and their Jacobian (N, 2, 29).

    `parameters` (29,): the homographies row by row, the camera's and the projector's bend.
    """
    camera, projector = (
        without_lens(device[0], device[1:3], bend)
        for device, bend in ((camera, parameters[-2]), (projector, parameters[-1]))
    )
    homographies = parameters[:-2].reshape(3, 3, 3)[cells.plane]
    rays, by_camera = unproject(camera, cells.camera_px)
    pixels, by_point, by_projector = project(projector, np.einsum("nij,nj->ni", homographies, rays))
    jacobian = np.zeros((len(parameters), 2, len(cells))).T
    by_homography = (by_point[:, :, :, None] * rays[:, None, None, :]).reshape(-1, 2, 9)
    for face in FACES:
        jacobian[cells.plane == face, :, 9 * face : 9 * face + 9] = by_homography[cells.plane == face]
    jacobian[:, :, -2] = np.einsum("nij,njk,nk->ni", by_point, homographies, by_camera[:, :, 3])
    jacobian[:, :, -1] = by_projector[:, :, 3]
    sigma = cells.sigma_px[:, None]
    return (pixels - cells.projector_px) / sigma, jacobian / sigma[:, :, None]
