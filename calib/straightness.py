"""How much both lenses bend, from the straightness of planes alone, before anything else is known.

What a homography through ideal pixels cannot explain on any of the planes is the lenses' doing. Lenses that are left in
bend the picture of a corner so much that it may not look like one.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib.arrays import Floats
from calib.cells import Cells
from calib.homography import FACES, dehomogenise, dlt_gram, homogeneous, homography_from_gram, normalisation
from calib.lens import project, unproject
from calib.matches import Matches

# Beforehand, of the bend in units of an image's width: that of a lens with k1 = 0.1 and a focal length of half a width.
_SIGMA = 0.4
_STEPS = 30


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
    start = np.concatenate([_homographies(faces, camera, projector).ravel(), np.zeros(2)])
    sigma = faces.sigma_px[:, None]

    def residual(parameters: Floats) -> Floats:
        predicted, _ = _predict(faces, camera, projector, parameters)
        return np.concatenate([((predicted - faces.projector_px) / sigma).ravel(), parameters[-2:] / _SIGMA])

    def jacobian(parameters: Floats) -> Floats:
        _, derivatives = _predict(faces, camera, projector, parameters)
        flat = (derivatives / sigma[:, :, None]).reshape(-1, len(parameters))
        prior = np.zeros((2, len(parameters)))
        prior[:, -2:] = np.eye(2) / _SIGMA
        return np.concatenate([flat, prior])

    found = least_squares(residual, start, jacobian, x_scale="jac", max_nfev=_STEPS).x
    camera[3], projector[3] = found[-2:]
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
        before, after = normalisation(source), normalisation(target)
        gram = dlt_gram(dehomogenise(homogeneous(source) @ before.T), dehomogenise(homogeneous(target) @ after.T))
        homography = np.linalg.inv(after) @ homography_from_gram(gram) @ before
        homographies.append(homography / np.linalg.norm(homography))
    return np.stack(homographies)


def _predict(cells: Cells, camera: Floats, projector: Floats, parameters: Floats) -> tuple[Floats, Floats]:
    """Projector pixels (M, 2) and derivatives (M, 2, 29) by three homographies and both bends."""
    homographies = parameters[:-2].reshape(3, 3, 3)[cells.plane]
    camera, projector = camera.copy(), projector.copy()
    camera[3], projector[3] = parameters[-2:]
    rays, by_camera = unproject(camera, cells.camera_px)
    pixels, by_point, by_projector = project(projector, np.einsum("nij,nj->ni", homographies, rays))
    derivatives = np.zeros((len(rays), 2, len(parameters)))
    by_homography = by_point[:, :, :, None] * rays[:, None, None, :]
    for face in FACES:
        on_face = cells.plane == face
        derivatives[on_face, :, 9 * face : 9 * face + 9] = by_homography[on_face].reshape(-1, 2, 9)
    derivatives[:, :, -2] = np.einsum("nij,njk,nk->ni", by_point, homographies, by_camera[:, :, 3])
    derivatives[:, :, -1] = by_projector[:, :, 3]
    return pixels, derivatives
