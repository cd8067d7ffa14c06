"""A calibration found from a corner, with what belongs to it; and the focal lengths at which the search begins."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.diagnostics import NextView, Uncertainty
from calib.finding import Finding
from calib.geometry import Calibration, Corner, Matches
from calib.numerics import Floats
from calib.self_calibration.known_calibration import KnownCalibration

Method = Literal["refined", "paper"]

# Trial focals, in units of the longer side of the camera's image: from a 120° to a 14° field of view.
_SHORTEST, _LONGEST = 0.3, 4.0
_PAPER_TRIALS, _SWEEP_TRIALS = 64, 24


@dataclass(frozen=True)
class Profile:
    """The curve searched over the camera's focal length."""

    focal_px: Floats
    """(n,)"""
    cost: Floats
    """(n,)"""


@dataclass(frozen=True)
class SelfCalibration:
    """A calibration found from the corner alone, in units of the baseline (|t| = 1)."""

    calibration: Calibration
    """Of both devices."""
    matches: Matches
    """Labelled with their faces."""
    corner: Corner
    """In the camera's frame."""
    profile: Profile
    """Over the camera's focal length."""
    residual_px: float
    """Root mean square reprojection error of a match in the projector."""
    method: Method
    """By which it was found."""
    findings: tuple[Finding, ...] = ()
    """For the user."""
    uncertainty: Uncertainty | None = None
    """None for a method that estimates none."""
    order_nats: float = 0.0
    """For captures of one corner, the log likelihood ratio between the numbering of the faces and the next best one,
    given the corner's angles; 0 where the angles do not distinguish them."""
    at_rest_percent: float = 0.0
    """Standard deviation of the intrinsics without shifts of the matches, a part of the sigmas."""
    likely_percent: float = 0.0
    """The same from likely shifts alone."""
    possible_percent: float = 0.0
    """The same from undetectable shifts."""
    known: KnownCalibration | None = None
    """The calibration it was combined with, if any."""
    next_view: NextView | None = None
    """Where another capture would help most; None if no view sees the corner or the method does not compute it."""
    corners_covariance: Floats | None = None
    """(21 + 6 n, 21 + 6 n): of the calibration's columns and, for each of n captures, of the rotation of its corner
    about the camera's axes and the shift of its vertex as a share of its distance."""

    @property
    def metric(self) -> Calibration:
        """The calibration in the unit of the known calibration; in baselines if there is none or it has no unit."""
        if self.known is None or self.uncertainty is None:
            return self.calibration
        return self.known.metric(self.calibration, self.uncertainty)


def paper_trials(camera_size: tuple[int, int]) -> Floats:
    """The camera focals (n,) that the paper's search samples, for a camera of (width, height)."""
    return _trials(camera_size, _PAPER_TRIALS)


def sweep_trials(camera_size: tuple[int, int]) -> Floats:
    """The camera focals (n,) at which the refinement starts, for a camera of (width, height)."""
    return _trials(camera_size, _SWEEP_TRIALS)


def _trials(camera_size: tuple[int, int], count: int) -> Floats:
    return np.geomspace(_SHORTEST * max(camera_size), _LONGEST * max(camera_size), count)
