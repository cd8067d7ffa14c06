"""What matches say of a rig by their epipolar lines alone: little, but from one capture of anything."""

from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import ROBUST_SIGMAS
from calib.geometry import Calibration, Intrinsics, Matches
from calib.numerics import Floats, Ints, clustered_scatter, huber_loss, huber_weights, robust_sigma
from calib.refinement import SHARED, State, device_of
from calib.scene.residuals import missed

_STEPS, _CONVERGED = 12, 1e-3  # sigmas
_HALVINGS = 6  # of a step that makes it worse
_BLOCK_PX = 32.0  # of the camera: decoders' errors are smooth
# Standard deviations of what lines do not tell, about the given rig: wide for any change of the same devices.
_OF_DEVICE = (0.2, 60.0, 60.0, 0.02, 0.05, 1e-3, 1e-3, 1e-3)
_LOOSE = np.array([*_OF_DEVICE, *_OF_DEVICE, *[0.1] * 3, *[0.2] * 2])


@dataclass(frozen=True, eq=False)
class RigByLines:
    """The rig near a given one under which rays meet best."""

    step: Floats
    """(21,): from the given rig towards it."""
    information: Floats
    """(21, 21): inverse covariance of `step`, nearly nothing along what lines do not tell."""
    given_px: float
    """Robust standard deviation by which rays miss each other under the given rig, in projector pixels."""
    best_px: float
    """The same under the best one."""


def rig_by_lines(given: State, matches: Matches) -> RigByLines:
    """The rig near a given one under which the rays of matches meet best.

    Errors of neighbouring matches may be one, so that scores are summed by blocks of the picture (Liang and Zeger,
    1986); what they scatter more than the curvature expects is taken off the information.
    """
    sigma = np.ones(len(matches)) if matches.sigma_px is None else matches.sigma_px
    precision = _LOOSE**-2.0
    rig, moved = given, np.zeros(SHARED)
    miss, by_shared, _ = missed(rig, matches, 1.0)
    scales = [max(robust_sigma(miss), 1e-3)]
    for _ in range(_STEPS):
        scale = scales[-1]
        weight = huber_weights(np.abs(miss) / scale, ROBUST_SIGMAS)
        normal = (by_shared * weight[:, None]).T @ by_shared / scale**2 + np.diag(precision)
        step = -_solved(normal, by_shared.T @ (weight * miss) / scale**2 + precision * moved)
        cost = _cost(miss, scale, moved)
        for _ in range(_HALVINGS):
            next_miss, next_by_shared, _ = missed(rig.moved(step), matches, 1.0)
            if _cost(next_miss, scale, moved + step) < cost:
                break
            step /= 2
        else:
            break
        rig, moved, miss, by_shared = rig.moved(step), moved + step, next_miss, next_by_shared
        scales.append(max(robust_sigma(miss), 1e-3))
        if float(step @ normal @ step) < _CONVERGED**2:
            break
    weight = huber_weights(np.abs(miss) / scales[-1], ROBUST_SIGMAS)
    miss, by_shared = miss / scales[-1], by_shared / scales[-1]
    normal = (by_shared * weight[:, None]).T @ by_shared + np.diag(precision)
    # The valley of what lines do not tell is curved: how far the given rig is off is judged by the slope at it.
    scatter = clustered_scatter((weight * miss)[:, None] * by_shared, _blocks(matches.camera_px)) + np.diag(precision)
    scatter -= normal
    miss, by_shared, _ = missed(given, matches, scales[-1])
    normal = (by_shared * weight[:, None]).T @ by_shared + np.diag(precision)
    scatter += normal
    step = -_solved(normal, by_shared.T @ (weight * miss))
    size = np.sqrt(np.diag(normal))
    root = np.linalg.cholesky(normal / np.outer(size, size)) * size[:, None]
    white = np.linalg.solve(root, np.linalg.solve(root, scatter).T)
    excess, directions = np.linalg.eigh((white + white.T) / 2)
    turned = root @ directions
    usual = float(np.median(sigma))
    return RigByLines(step, (turned / np.maximum(excess, 1.0)) @ turned.T, usual * scales[0], usual * scales[-1])


def _cost(miss: Floats, scale: float, moved: Floats) -> float:
    """Of misses (L,) with this standard deviation, and of a rig's step (21,) from the given one."""
    return float(huber_loss(np.abs(miss) / scale, ROBUST_SIGMAS).sum() + np.sum((moved / _LOOSE) ** 2))


def in_square_pixels(calibration: Calibration, matches: Matches) -> tuple[State, Matches]:
    """The rig with square pixels, in baselines, and the matches as its devices would have them.

    Each coordinate is stretched about the principal point to the mean of both focal lengths, which changes no ray.
    """
    (camera, camera_px), (projector, projector_px) = (
        _in_square_pixels(device, np.asarray(pixels, np.float64))
        for device, pixels in (
            (calibration.camera, matches.camera_px),
            (calibration.projector, matches.projector_px),
        )
    )
    return State(camera, projector, calibration.pose.in_baselines), replace(
        matches, camera_px=camera_px, projector_px=projector_px
    )


def _in_square_pixels(device: Intrinsics, pixels: Floats) -> tuple[Floats, Floats]:
    """A device (8,) of one focal length, and pixels (N, 2) as it would have them."""
    focal, centre = float(np.mean(device.focal_px)), np.array(device.principal_point_px)
    stretched: Floats = centre + (pixels - centre) * (focal / np.array(device.focal_px))
    return device_of(replace(device, focal_px=(focal, focal))), stretched


def _solved(normal: Floats, right: Floats) -> Floats:
    size = np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.solve(normal / np.outer(size, size), right / size) / size, np.float64)


def _blocks(camera_px: Floats) -> Ints:
    """Numbers (N,) of the squares of the picture that pixels (N, 2) are in."""
    _, number = np.unique((camera_px // _BLOCK_PX).astype(np.int64), axis=0, return_inverse=True)
    return number.reshape(-1)
