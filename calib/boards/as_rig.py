"""What boards say of a rig, in the columns that every corner determines.

Boards determine more terms of a lens than those: the pixels' shape, k3, p1 and p2. Their estimates are part of the
calibration, but how unsure they are has to be said by the columns that corners have always: to first order an error of
a further term is what a change of the columns comes nearest to, by least squares over what both devices see. A
lens that has another term also points elsewhere, so a turn of the device is part of that change.
"""

from dataclasses import replace

import numpy as np

from calib.boards.acceptance import rays_seen
from calib.boards.calibrate import BoardCalibration, calibration_from
from calib.boards.estimate import Estimate
from calib.boards.likelihood import lens_prior, minimise
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
from calib.geometry import Calibration, Size, cross, tangent_basis
from calib.numerics import Floats
from calib.refinement import CAMERA as CAMERA_COLUMNS
from calib.refinement import PER_DEVICE as RIG_DEVICE
from calib.refinement import PROJECTOR as PROJECTOR_COLUMNS
from calib.refinement import ROTATION as ROTATION_COLUMNS
from calib.refinement import SHARED as COLUMNS
from calib.refinement import TRANSLATION as TRANSLATION_COLUMNS
from calib.refinement import State, covariance_of

_OWN = [FOCAL, CENTRE.start, CENTRE.start + 1, LENS.start, LENS.start + 1]
_FURTHER = [ASPECT, *range(LENS.start + 2, LENS.stop)]


def rig_uncertainty(found: Estimate, sizes: tuple[Size, Size]) -> Uncertainty:
    """Of an estimate from boards, for devices of these sizes."""
    state, to_columns = found.state, _to_columns(found, sizes)
    none = np.zeros(RIG_DEVICE - len(_OWN))
    rig = State(
        np.append(state.camera[_OWN], none),
        np.append(state.projector[_OWN], none),
        state.motion.rotation,
        state.motion.translation / state.motion.length,
        np.zeros((0, 3)),
        (),
    )
    return Uncertainty(
        rig,
        to_columns @ found.covariance @ to_columns.T,
        None,
        float(np.median([noise.match_px for noise in found.noise])),
        with_log_baseline=to_columns @ found.covariance[:, LENGTH],
    )


def with_radial_terms(found: BoardCalibration, sizes: tuple[Size, Size]) -> tuple[Calibration, Uncertainty] | None:
    """The same with k1 and k2 of both devices free, as a corner has them; None where they were.

    Terms for which boards give no evidence are left out, which may be wrong where there was no board: a corner that is
    seen there can tell.
    """
    estimate, wide = found.estimate, lens_prior(*sizes, 0).sigma
    radial = [device.start + LENS.start + term for device in (CAMERA, PROJECTOR) for term in (0, 1)]
    if np.all(estimate.prior.sigma[radial] > 0):
        return None
    sigma = estimate.prior.sigma.copy()
    sigma[radial] = wide[radial]
    prior = replace(estimate.prior, sigma=sigma)
    fit = minimise(estimate.views, estimate.state, prior, estimate.levels)
    own = covariance_of(fit.information, prior.free(fit.state))[:SHARED, :SHARED]
    freed = replace(estimate, fit=fit, prior=prior, covariance=found.enlarged**2 * (own + estimate.terms.spread))
    return calibration_from(freed, *sizes, found.calibration.unit), rig_uncertainty(freed, sizes)


def _to_columns(found: Estimate, sizes: tuple[Size, Size]) -> Floats:
    """What a step of what boards share is in the rig's columns, (21, 31)."""
    motion = found.state.motion
    ahead = motion.translation / motion.length
    to_columns = np.zeros((COLUMNS, SHARED))
    to_columns[ROTATION_COLUMNS, ROTATION] = np.eye(3)
    to_columns[TRANSLATION_COLUMNS, DIRECTION] = np.eye(2)
    devices = ((CAMERA_COLUMNS, CAMERA, found.state.camera), (PROJECTOR_COLUMNS, PROJECTOR, found.state.projector))
    for (columns, block, device), pixels in zip(devices, rays_seen(found.state, sizes), strict=True):
        own, turn = _in_place_of_further_terms(device, pixels)
        to_columns[columns, block] = own
        # X_projector = R X_camera + t stays true of the turned device's own frame.
        if block == CAMERA:
            to_columns[ROTATION_COLUMNS, block] -= motion.rotation @ turn
        else:
            to_columns[ROTATION_COLUMNS, block] += turn
            to_columns[TRANSLATION_COLUMNS, block] += tangent_basis(ahead).T @ cross(turn.T, ahead).T
    return to_columns


def _in_place_of_further_terms(device: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """What a step of a device (9,) is in the rig's columns for it (8, 9), and as a turn (3, 9)."""
    own, turn = np.zeros((RIG_DEVICE, PER_DEVICE)), np.zeros((3, PER_DEVICE))
    own[: len(_OWN), _OWN] = np.eye(len(_OWN))
    by_turn, by_device = project_rays(device, rays_of(device, pixels))
    basis = np.concatenate([by_device[:, :, _OWN], by_turn], axis=2).reshape(-1, len(_OWN) + 3)
    scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-12)
    further = by_device[:, :, _FURTHER].reshape(len(basis), len(_FURTHER))
    nearest = np.linalg.lstsq(basis / scale, further)[0] / scale[:, None]
    own[: len(_OWN), _FURTHER], turn[:, _FURTHER] = nearest[: len(_OWN)], nearest[len(_OWN) :]
    return own, turn
