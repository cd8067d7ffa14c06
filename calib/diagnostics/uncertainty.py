"""What the covariance means for a person: sigmas by name, the uncertainty of a point, the price of an assumption."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Calibration, Intrinsics, Matches, cross, nearest_depths, tangent_basis, unproject
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, TRANSLATION, Prior, State

Sigmas = dict[str, float | tuple[float, ...]]


@dataclass(frozen=True)
class Uncertainty:
    """Of a rig: its state and `covariance` (15, 15) of the columns of devices and motion; lengths in baselines.

    `by_principal_point` (15, 2): how the columns move with the camera's principal point, per pixel, where that was
    taken as known; else None. `match_px`: scatter of a match where it states no sigma of its own.
    """

    state: State
    covariance: Floats
    by_principal_point: Floats | None
    match_px: float

    def of_points(self, matches: Matches) -> Floats:
        """Standard deviations (N, 3) of triangulated points in the camera's frame, in baselines: along x, y, z.

        A point is where the camera's ray r comes nearest to the projector's, X = r d, so δX = r δd + d δr.
        """
        rays, rays_by_camera = unproject(self.state.camera, matches.camera_px)
        directions, directions_by_projector = unproject(self.state.projector, matches.projector_px)
        turned = rays @ self.state.rotation.T
        depth, by_turned, by_direction, by_translation = nearest_depths(turned, directions, self.state.translation)
        by_shared = np.zeros((len(rays), SHARED))
        by_shared[:, CAMERA] = np.einsum("ni,nij->nj", by_turned @ self.state.rotation, rays_by_camera)
        by_shared[:, PROJECTOR] = np.einsum("ni,nij->nj", by_direction, directions_by_projector)
        by_shared[:, ROTATION] = cross(turned, by_turned)
        by_shared[:, TRANSLATION] = by_translation @ tangent_basis(self.state.translation)
        # Moving a pixel to the right is moving the principal point to the left.
        by_match = -by_shared[:, PROJECTOR.start + 1 : PROJECTOR.start + 3]

        jacobian = rays[:, :, None] * by_shared[:, None, :]
        jacobian[:, :, CAMERA] += depth[:, None, None] * rays_by_camera
        noise = np.full(len(rays), self.match_px) if matches.sigma_px is None else matches.sigma_px
        variance = np.einsum("nij,jk,nik->ni", jacobian, self.covariance, jacobian, optimize=True)
        variance += rays**2 * (np.sum(by_match**2, axis=1) * noise**2)[:, None]
        sigma: Floats = np.sqrt(variance)
        return sigma


def uncertainty_of(state: State, covariance: Floats, information: Floats, prior: Prior, match_px: float) -> Uncertainty:
    """From a refinement's covariance and Hessian (size, size) over all columns of `state`."""
    known = np.arange(CAMERA.start + 1, CAMERA.start + 3)
    sensitivity = None
    if not prior.free[known].any():
        free = np.flatnonzero(prior.free)
        moved = np.zeros((len(prior.free), 2))
        moved[free] = -np.linalg.lstsq(information[np.ix_(free, free)], information[np.ix_(free, known)], rcond=1e-14)[
            0
        ]
        moved[known] = np.eye(2)
        sensitivity = moved[state.followed][:SHARED]
    return Uncertainty(state, covariance[:SHARED, :SHARED], sensitivity, match_px)


def calibration_of(
    state: State, camera_size: tuple[int, int], projector_size: tuple[int, int], sigma: Sigmas
) -> Calibration:
    """A state's devices and motion as a calibration in baselines."""
    return Calibration(
        _intrinsics(camera_size, state.camera),
        _intrinsics(projector_size, state.projector),
        state.rotation,
        state.translation,
        sigma=sigma,
    )


def sigmas_by_name(state: State, covariance: Floats) -> Sigmas:
    """Standard deviations by their names in a calibration file; angles in degrees, those of the first corner."""
    sigma = np.sqrt(np.diag(covariance))
    sigmas: Sigmas = {}
    for name, device, columns in (("camera", state.camera, CAMERA), ("projector", state.projector, PROJECTOR)):
        focal, x0, y0, k1, k2 = (float(value) for value in sigma[columns])
        sigmas[f"{name}_focal_px"] = float(device[0]) * focal
        sigmas[f"{name}_principal_point_px"] = (x0, y0)
        sigmas[f"{name}_distortion"] = (k1, k2)
    sigmas["rotation_deg"] = tuple(float(value) for value in np.degrees(sigma[ROTATION]))
    sigmas["translation_direction_deg"] = float(np.degrees(np.hypot(*sigma[TRANSLATION])))
    angles = state.angle_columns(0)
    sigmas["corner_angles_deg"] = tuple(float(value) for value in np.degrees(sigma[angles]))
    return sigmas


def _intrinsics(size: tuple[int, int], device: Floats) -> Intrinsics:
    focal, x0, y0, k1, k2 = (float(value) for value in device)
    return Intrinsics(*size, (focal, focal), (x0, y0), (k1, k2, 0.0, 0.0, 0.0))
