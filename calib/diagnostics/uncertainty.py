"""The covariance of a rig: named sigmas, uncertainty of points, sensitivity to the principal point."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.geometry import (
    Calibration,
    DeviceSigmas,
    Intrinsics,
    Matches,
    Sigmas,
    cross,
    nearest_depths,
    unproject,
)
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, TRANSLATION, Prior, State

# Less probable states along the valley are left to the rest of the covariance.
_IMPROBABLE = 2e-3


@dataclass(frozen=True)
class Along:
    """The part of a covariance that is not linear: states along the curved valley of the camera's focal length.

    `steps` (K, 21) from the best state, `probability` (K,) of each; their covariance is Σ p s sᵀ.
    """

    steps: Floats
    probability: Floats

    @property
    def covariance(self) -> Floats:
        """Their part of the covariance, (21, 21)."""
        return (self.steps * self.probability[:, None]).T @ self.steps


NOWHERE = Along(np.zeros((0, SHARED)), np.zeros(0))


@dataclass(frozen=True)
class Uncertainty:
    """A rig's state and its covariance; lengths in baselines."""

    state: State
    covariance: Floats
    """Of the columns of devices and motion, (21, 21)."""
    by_principal_point: Floats | None
    """Derivatives of the columns by the camera's principal point, per pixel, if that was assumed as known, (21, 2);
    otherwise None.
    """
    match_px: float
    """Standard deviation of a match without a sigma of its own."""
    along: Along = NOWHERE
    """The curved part of the covariance."""
    with_log_baseline: Floats = field(default_factory=lambda: np.zeros(SHARED))
    """Covariance of the columns with the logarithm of the baseline, if something else than the baseline fixed the
    scale, (21,).
    """

    @property
    def by_log_baseline(self) -> Floats:
        """Regression coefficients (21,) of the baseline's logarithm on the columns."""
        scale = np.sqrt(self.covariance.diagonal())
        scale = np.where(scale > 0, scale, 1.0)
        gain: Floats = np.linalg.pinv(self.covariance / np.outer(scale, scale), hermitian=True) @ (
            self.with_log_baseline / scale
        )
        return gain / scale

    @property
    def rig(self) -> State:
        """The state without corners."""
        return self.state.rig

    def of_points(self, matches: Matches) -> Floats:
        """Standard deviations (N, 3) of triangulated points in the camera's frame, in baselines: along x, y, z."""
        by_shared, by_match = self.point_jacobians(matches)
        noise = np.full(len(matches), self.match_px) if matches.sigma_px is None else matches.sigma_px
        variance = np.einsum("nij,jk,nik->ni", by_shared, self.covariance, by_shared, optimize=True)
        variance += np.sum(by_match**2, axis=2) * (noise**2)[:, None]
        sigma: Floats = np.sqrt(variance)
        return sigma

    def point_jacobians(self, matches: Matches) -> tuple[Floats, Floats]:
        """Derivatives of triangulated points, in baselines: by the columns (N, 3, 21), by projector pixels (N, 3, 2).

        A point is where the camera's ray r is nearest to the projector's, X = r d, so δX = r δd + d δr.
        """
        rays, rays_by_camera = unproject(self.state.camera, matches.camera_px)
        directions, directions_by_projector = unproject(self.state.projector, matches.projector_px)
        pose = self.state.pose
        turned = pose.rotate(rays)
        depth, by_turned, by_direction, by_translation = nearest_depths(turned, directions, pose.translation)
        by_shared = np.zeros((len(rays), SHARED))
        by_shared[:, CAMERA] = np.einsum("ni,nij->nj", by_turned @ pose.rotation, rays_by_camera)
        by_shared[:, PROJECTOR] = np.einsum("ni,nij->nj", by_direction, directions_by_projector)
        by_shared[:, ROTATION] = cross(turned, by_turned)
        by_shared[:, TRANSLATION] = by_translation @ pose.by_direction
        # Moving a pixel to the right is equivalent to moving the principal point to the left.
        by_match = -by_shared[:, PROJECTOR.start + 1 : PROJECTOR.start + 3]

        jacobian = rays[:, :, None] * by_shared[:, None, :]
        jacobian[:, :, CAMERA] += depth[:, None, None] * rays_by_camera
        return jacobian, rays[:, :, None] * by_match[:, None, :]


def uncertainty_of(
    state: State, covariance: Floats, information: Floats, prior: Prior, match_px: float, along: Along = NOWHERE
) -> Uncertainty:
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
    return Uncertainty(state, covariance[:SHARED, :SHARED], sensitivity, match_px, along)


def along_valley(probability: Floats, steps: Floats) -> Along:
    """From probabilities (n,) of states and the steps (n, size) to them over all columns."""
    likely = probability > _IMPROBABLE
    return Along(steps[likely, :SHARED], probability[likely])


def calibration_of(
    state: State, camera_size: tuple[int, int], projector_size: tuple[int, int], sigma: Sigmas
) -> Calibration:
    """A state's devices and motion as a calibration in baselines."""
    return Calibration(
        Intrinsics.of_device(state.camera, camera_size),
        Intrinsics.of_device(state.projector, projector_size),
        state.pose,
        sigma=sigma,
    )


def with_pixels_of(intrinsics: Intrinsics, device: Intrinsics) -> Intrinsics:
    """A device found with square pixels, with the shape of another one's pixels."""
    focal = intrinsics.focal_px[0]
    return replace(intrinsics, focal_px=(focal, focal * device.focal_px[1] / device.focal_px[0]))


def moved_calibration(calibration: Calibration, uncertainty: Uncertainty, step: Floats) -> Calibration:
    """The calibration of this uncertainty, moved by a step (21,) of the columns; its baseline is kept."""
    there = calibration_of(
        uncertainty.rig.moved(step), calibration.camera.size, calibration.projector.size, calibration.sigma
    )
    return replace(
        there,
        camera=with_pixels_of(there.camera, calibration.camera),
        projector=with_pixels_of(there.projector, calibration.projector),
        pose=there.pose.scaled(calibration.baseline),
        unit=calibration.unit,
    )


def sigmas_of(state: State, covariance: Floats) -> Sigmas:
    """Standard deviations from a covariance of the state's columns; angles are those of the first corner, if any."""
    sigma = np.sqrt(np.diag(covariance))
    rotation, angles = (np.degrees(sigma[columns]) for columns in (ROTATION, state.angle_columns(0)))
    return Sigmas(
        DeviceSigmas.of_device(state.camera, covariance[CAMERA, CAMERA]),
        DeviceSigmas.of_device(state.projector, covariance[PROJECTOR, PROJECTOR]),
        (float(rotation[0]), float(rotation[1]), float(rotation[2])),
        float(np.degrees(np.hypot(*sigma[TRANSLATION]))),
        (float(angles[0]), float(angles[1]), float(angles[2])) if len(state.off_square) else None,
    )
