"""One known length → a calibration in metres."""

from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Corner
from scanner.configuration import ScaleSettings
from scanner.errors import InputError
from scanner.quantities import UNKNOWN_UNIT


def scaled(calibration: Calibration, corner: Corner | None, scale: ScaleSettings | None) -> Calibration:
    """Return the calibration in metres if a length is known; unchanged if none is, or if it has a unit already.

    `corner` is in the calibration's unit. The result's `sigma` records which length was known, and its sigma: 0 if
    exact. Raises InputError if the known length is the distance to a corner and there is none, or if it is that of a
    sheet.
    """
    if scale is None or calibration.unit != UNKNOWN_UNIT:
        return calibration
    if scale.charuco is not None:
        raise InputError("scale.charuco is for captures of a rig, whose projector lights the sheet")
    known = scale.sigma_m or 0.0
    if scale.baseline_m is not None:
        sigma = replace(calibration.sigma, known_baseline=known)
        factor = scale.baseline_m / calibration.baseline
    elif scale.camera_to_corner_m is not None:
        if corner is None:
            raise InputError("scale.camera_to_corner_m needs the corner, which is not looked for with a --calibration")
        sigma = replace(calibration.sigma, known_camera_to_corner=known)
        factor = scale.camera_to_corner_m / float(np.linalg.norm(corner.vertex))
    else:
        return calibration
    return replace(calibration.scaled(factor, "m"), sigma=sigma)
