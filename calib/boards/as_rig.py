"""The estimate from boards, in the columns that every corner determines.

Boards also determine the aspect of pixels. It is part of the calibration, but its uncertainty must be expressed by the
columns of corners. To first order, an error of it is replaced by the change of the columns, and rotation of the device,
that approximates it best, by least squares over the common view.
"""

import numpy as np

from calib.boards.acceptance import rays_seen
from calib.boards.estimate import Estimate
from calib.boards.parameters import (
    ASPECT,
    CAMERA,
    CENTRE,
    DIRECTION,
    FOCAL,
    LENGTH,
    LENS,
    PER_DEVICE,
    PROJECTOR,
    ROTATION,
    SHARED,
    project_rays,
    rays_of,
)
from calib.diagnostics import Uncertainty
from calib.geometry import Size, cross, tangent_basis
from calib.numerics import Floats
from calib.refinement import CAMERA as CAMERA_COLUMNS
from calib.refinement import PROJECTOR as PROJECTOR_COLUMNS
from calib.refinement import ROTATION as ROTATION_COLUMNS
from calib.refinement import SHARED as COLUMNS
from calib.refinement import TRANSLATION as TRANSLATION_COLUMNS
from calib.refinement import State

_OWN = [FOCAL, *range(CENTRE.start, LENS.stop)]


def rig_uncertainty(estimate: Estimate, sizes: tuple[Size, Size]) -> Uncertainty:
    """Of an estimate from boards, for devices of these sizes."""
    state, to_columns = estimate.state, _to_columns(estimate, sizes)
    rig = State(state.camera[_OWN], state.projector[_OWN], state.pose.in_baselines)
    return Uncertainty(
        rig,
        to_columns @ estimate.covariance @ to_columns.T,
        None,
        float(np.median([noise.match_px for noise in estimate.noise])),
        with_log_baseline=to_columns @ estimate.covariance[:, LENGTH],
    )


def _to_columns(estimate: Estimate, sizes: tuple[Size, Size]) -> Floats:
    """What a step of what boards share is in the rig's columns, (21, 31)."""
    pose = estimate.state.pose
    ahead = pose.translation / pose.distance
    to_columns = np.zeros((COLUMNS, SHARED))
    to_columns[ROTATION_COLUMNS, ROTATION] = np.eye(3)
    to_columns[TRANSLATION_COLUMNS, DIRECTION] = np.eye(2)
    devices = (
        (CAMERA_COLUMNS, CAMERA, estimate.state.camera),
        (PROJECTOR_COLUMNS, PROJECTOR, estimate.state.projector),
    )
    for (columns, block, device), pixels in zip(devices, rays_seen(estimate.state, sizes), strict=True):
        own, turn = _in_place_of_aspect(device, pixels)
        to_columns[columns, block] = own
        # In the rotated device's own frame, X_projector = R X_camera + t is unchanged.
        if block == CAMERA:
            to_columns[ROTATION_COLUMNS, block] -= pose.rotation @ turn
        else:
            to_columns[ROTATION_COLUMNS, block] += turn
            to_columns[TRANSLATION_COLUMNS, block] += tangent_basis(ahead).T @ cross(turn.T, ahead).T
    return to_columns


def _in_place_of_aspect(device: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the rig's columns for a device by a step (9,) of it, (8, 9), and of a rotation (3, 9)."""
    count = len(_OWN)
    own, turn = np.zeros((count, PER_DEVICE)), np.zeros((3, PER_DEVICE))
    own[:, _OWN] = np.eye(count)
    by_turn, by_device = project_rays(device, rays_of(device, pixels))
    basis = np.concatenate([by_device[:, :, _OWN], by_turn], axis=2).reshape(-1, count + 3)
    scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-12)
    nearest = np.linalg.lstsq(basis / scale, by_device[:, :, ASPECT].ravel())[0] / scale
    own[:, ASPECT], turn[:, ASPECT] = nearest[:count], nearest[count:]
    return own, turn
