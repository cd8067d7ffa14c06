"""Judges a capture by the truth: right, refused although decodable, or confident and wrong."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from calib.geometry import Calibration, Matches, mapped
from calib.numerics import Bools, Floats
from calib.plane_segmentation import find_faces
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, self_calibrate
from scanner.quantities import intrinsic_errors_percent

MOST_SIGMAS = 4.0
MOST_PERCENT = 2.0
MOST_MATCH_ERROR_PX = 0.5  # median
# Largest median error of an uncalibrated capture, in sigmas; for normal errors it is 0.67 along a line and 1.2 in the
# plane.
MOST_MATCH_SIGMAS = 2.0
DISTURBED_PX = 2.0
_NUMBERS = 4


@dataclass(frozen=True)
class Truth:
    """Ground truth of a simulated capture: `projector_px` (H, W, 2), NaN outside the picture; `calibration`.

    `moved_px`: shift of the frames relative to `projector_px`. `pinhole`: whether the projector is a pinhole with
    square pixels. If not, only the camera's focal length is judged, and matches may also be pixels of the panel;
    `panel` (3, 3) is the homography from the picture to it.
    """

    projector_px: Floats
    calibration: Calibration
    pinhole: bool = True
    moved_px: tuple[float, float] = (0.0, 0.0)
    panel: Floats | None = None

    def moved(self, by_px: tuple[float, float]) -> "Truth":
        """The calibration of shifted frames, with its principal point shifted."""
        camera = self.calibration.camera
        x, y = camera.principal_point_px
        there = replace(camera, principal_point_px=(x + by_px[0], y + by_px[1]))
        return replace(self, calibration=replace(self.calibration, camera=there), moved_px=by_px)

    @property
    def lit(self) -> Bools:
        """Mask (H, W) of pixels lit together with all pixels around them."""
        seen = np.isfinite(self.projector_px[..., 0]).astype(np.uint8)
        lit: Bools = cv2.erode(seen, np.ones((3, 3), np.uint8)) > 0
        return lit


@dataclass(frozen=True)
class CalibrationError:
    """Errors of f_c, f_p, x_p, y_p, or of the first of them: `percent` (k,) of the truth, and `sigmas` (k,)."""

    percent: Floats
    sigmas: Floats

    @property
    def is_wrong(self) -> bool:
        """Whether an error exceeds the limits of an accepted result."""
        return not (self._worst(self.sigmas) <= MOST_SIGMAS and self._worst(self.percent) <= MOST_PERCENT)

    @property
    def is_useful(self) -> bool:
        """Whether an error is within one of the limits."""
        return self._worst(self.sigmas) <= MOST_SIGMAS or self._worst(self.percent) <= MOST_PERCENT

    @staticmethod
    def _worst(values: Floats) -> float:
        return float(np.abs(values).max())


def calibration_error(found: Calibration, truth: Truth) -> CalibrationError:
    """Errors of a calibration. Without a stated sigma, the error is not counted in sigmas."""
    number = _NUMBERS if truth.pinhole else 1
    percent = intrinsic_errors_percent(found, truth.calibration)[:number]
    true = truth.calibration
    values = np.array([true.camera.focal_px[0], true.projector.focal_px[0], *true.projector.principal_point_px])
    sigma = found.sigma
    focals = [device.focal_px[0] if device.focal_px else 0.0 for device in (sigma.camera, sigma.projector)]
    stated = np.array([*focals, *(sigma.projector.principal_point_px or (0.0, 0.0))])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = percent / 100 * values[:number] / stated[:number]
    return CalibrationError(percent, sigmas)


def match_errors(matches: Matches, truth: Truth, *, in_sigmas: bool = False) -> Floats:
    """Distances (k,) from the true projector pixels, in projector px or in sigmas of the matches.

    Matches at edges, and where nothing is lit, are left out.
    """
    expected = _expected_px(matches, truth)
    seen = np.isfinite(expected[:, 0])
    expected, found = expected[seen], np.asarray(matches.projector_px, np.float64)[seen]
    errors: Floats = np.linalg.norm(found - expected, axis=1)
    if in_sigmas and matches.sigma_px is not None:
        return errors / np.asarray(matches.sigma_px, np.float64)[seen]
    if truth.panel is None or not len(errors):
        return errors
    off = found - mapped(truth.panel, expected)
    # The origin of the panel is only determined to a part of a pixel.
    on_panel: Floats = np.linalg.norm(off - np.rint(np.median(off, axis=0)), axis=1)
    return min(errors, on_panel, key=np.median)


def _expected_px(matches: Matches, truth: Truth) -> Floats:
    """The true projector pixels of matches, (N, 2), NaN at edges and where nothing is lit."""
    places = (np.asarray(matches.camera_px, np.float64) - truth.moved_px).T[::-1]
    expected = [ndimage.map_coordinates(truth.projector_px[..., axis], places, order=1, cval=np.nan) for axis in (0, 1)]
    return np.stack(expected, axis=1)


def matched_share(matches: Matches, truth: Truth) -> float:
    """Share of the lit pixels that have a match, or a neighbour with one."""
    matched = np.zeros(truth.lit.shape, np.uint8)
    x, y = np.rint(matches.camera_px).astype(int).T
    matched[y, x] = 1
    near = cv2.dilate(matched, np.ones((3, 3), np.uint8)) > 0
    return float(near[truth.lit].mean())


def could_be_decoded(candidates: Sequence[Matches], truth: Truth, *, calibrated: bool = False) -> bool:
    """Whether any of the plain decodings is right, and the calibration from it useful, if there is one.

    If most matches are right, the others may be masked, as where a person passes.
    """
    possible = [some for matches in candidates for some in (matches, _undisturbed(matches, truth))]
    return any(_is_right(some, truth) and (calibrated or _calibrates(some, truth)) for some in possible)


def _undisturbed(matches: Matches, truth: Truth) -> Matches:
    expected = _expected_px(matches, truth)
    near = np.linalg.norm(matches.projector_px - expected, axis=1) < DISTURBED_PX
    if np.mean(near[np.isfinite(expected[:, 0])]) < 1 / 2:
        return matches
    return Matches(matches.camera_px[near], matches.projector_px[near])


def _is_right(matches: Matches, truth: Truth) -> bool:
    errors = match_errors(matches, truth)
    return bool(errors.size) and float(np.median(errors)) <= MOST_MATCH_ERROR_PX


def _calibrates(matches: Matches, truth: Truth) -> bool:
    camera, projector = truth.calibration.camera, truth.calibration.projector
    sizes = (camera.width, camera.height), (projector.width, projector.height)
    known = PrincipalPoint(camera.principal_point_px, 0.0)
    try:
        labelled = find_faces(matches, *sizes).matches
        found = self_calibrate(labelled, *sizes, principal_point=known, squareness_deg=0.0)
    except RefusalError:
        return False
    return calibration_error(found.calibration, truth).is_useful
