"""A rig as the estimate of a room has it: one focal length a device; or held as it was given."""

from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Intrinsics, Matches
from calib.refinement import State, device_of
from scanner.rooms.contents import RigStart


def state_of(calibration: Calibration) -> State:
    """The model's parameters of a calibration in baselines."""
    camera, projector = (
        device_of(replace(device, focal_px=(float(np.mean(device.focal_px)),) * 2))
        for device in (calibration.camera, calibration.projector)
    )
    direction = calibration.translation / calibration.baseline
    return State(camera, projector, calibration.rotation, direction, np.zeros((0, 3)), ())


def is_estimated(start: RigStart) -> bool:
    """Whether the rig is estimated together with the room, or held as it was given, without a covariance."""
    return bool(start.corners) or start.uncertainty is not None


def ideal_rig(calibration: Calibration) -> Calibration:
    """The same rig with devices that have one focal length each and no distortion."""
    camera, projector = (
        Intrinsics(device.width, device.height, (float(np.mean(device.focal_px)),) * 2, device.principal_point_px)
        for device in (calibration.camera, calibration.projector)
    )
    return replace(calibration, camera=camera, projector=projector)


def ideal_matches(matches: Matches, start: RigStart) -> Matches:
    """The matches of an ideal rig if the rig is fixed: the distortion of its lenses is removed."""
    if is_estimated(start):
        return matches
    given, ideal = start.calibration, ideal_rig(start.calibration)
    camera_px = ideal.camera.project(given.camera.unproject(matches.camera_px.astype(np.float64)))
    projector_px = ideal.projector.project(given.projector.unproject(matches.projector_px.astype(np.float64)))
    beyond = ~np.isfinite(np.hstack([camera_px, projector_px])).all(axis=1)
    camera_px[beyond], projector_px[beyond] = matches.camera_px[beyond], matches.projector_px[beyond]
    return Matches(camera_px, projector_px, None, matches.sigma_px)
