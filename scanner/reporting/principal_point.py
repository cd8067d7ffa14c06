"""The price of an assumption: what an error of a principal point that was taken as known would cost."""

from dataclasses import dataclass

import numpy as np

from calib.refinement import CAMERA, PROJECTOR
from calib.self_calibration import SelfCalibration
from scanner.quantities import plain

_SHIFT_PX = 10.0


@dataclass(frozen=True)
class PrincipalPointEffect:
    """The effect of the assumption: `sentences` for a person, none without one; `per_px`: relative change of the larger
    focal length.
    """

    sentences: tuple[str, ...] = ()
    per_px: float = 0.0


def effect_of_principal_point(solution: SelfCalibration | None) -> PrincipalPointEffect:
    """Return the effect of an error in a principal point that was taken as known."""
    if solution is None or solution.uncertainty is None or solution.uncertainty.by_principal_point is None:
        return PrincipalPointEffect()
    by_pixel = solution.uncertainty.by_principal_point[[CAMERA.start, PROJECTOR.start]]  # of log f
    effects = [
        f"{_SHIFT_PX:g} px in {axis} would move the camera's focal length by {plain(100 * camera, 2, signed=True)} % "
        f"and the projector's by {plain(100 * projector, 2, signed=True)} %"
        for axis, (camera, projector) in zip("xy", _SHIFT_PX * by_pixel.T, strict=True)
    ]
    sentence = f"The camera's principal point was taken as known. If it is elsewhere: {'; '.join(effects)}."
    return PrincipalPointEffect((sentence,), float(np.linalg.norm(by_pixel, axis=1).max()))
