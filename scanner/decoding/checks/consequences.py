"""What comes of frames that are odd: decoded all the same, and judged by the coordinates.

Whatever device, light or scene: what one camera and one projector see obeys one epipolar geometry, and what codes and
fringes say agrees with itself and with the pixels around it. A frame that shows something else breaks this where
its pattern differs; a lamp that flickers or a person who walks by breaks it nowhere, or there only.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import cv2
import numpy as np

from calib.geometry import Matches
from calib.numerics import Floats
from scanner.decoding.arrays import Reasons
from scanner.decoding.checks.contradictions import Anomaly
from scanner.decoding.mask_reasons import BROKEN, MaskReason, count_reasons
from scanner.decoding.significance import FEWEST_PIXELS, SIGNIFICANT_SIGMAS
from scanner.errors import InputError

# A frame that shows another pattern is wrong where the two differ, at half of the pixels; then at least a part of the
# coordinates that depend on it contradict the others or break the surface. People in the picture cover less.
_MOST_BROKEN = 0.35
# Distance from the epipolar line in projector pixels that a lens without a model, or a poor sigma, may explain.
EPIPOLAR_PX = 3.0
_MOST_OUTLIERS = 0.15
_MOST_MATCHES = 4000
_SEED = 5


@contextmanager
def suspecting(anomalies: Sequence[Anomaly]) -> Iterator[None]:
    """Names what is odd about the frames in an InputError that follows from it."""
    try:
        yield
    except InputError as error:
        if not anomalies:
            raise
        raise InputError(f"{_description(anomalies)}; and {error}") from error


def judge(anomalies: Sequence[Anomaly], reasons: Reasons, matches: Matches, *, one_axis: bool = False) -> str:
    """A sentence for the operator about odd frames that do no harm; of all pixels the `reasons` (H, W).

    `one_axis`: the matches were put on the lines of an epipolar geometry, so that it cannot judge them.

    Raises InputError if they do.
    """
    counts = count_reasons(reasons, (MaskReason.KEPT, *BROKEN))
    broken = int(sum(counts[reason] for reason in BROKEN))
    share = broken / max(1, broken + int(counts[MaskReason.KEPT]))
    if share > _MOST_BROKEN:
        raise InputError(
            f"{_description(anomalies)}; and {share:.0%} of the lit pixels are inconsistent in themselves or with "
            "their surface: did something move in most of the picture, or were frames exchanged?"
        )
    if len(matches) < FEWEST_PIXELS:
        return f"{_description(anomalies)}. Too few pixels have a match to assess the effect."
    if one_axis:
        return (
            f"{_description(anomalies)}. It was decoded nevertheless: {1 - share:.0%} of the lit pixels are consistent."
        )
    distance, outliers = _epipolar(matches)
    if outliers > _MOST_OUTLIERS:
        raise InputError(
            f"{_description(anomalies)}; and {outliers:.0%} of the matches are more than {EPIPOLAR_PX:g} projector "
            "pixels from the epipolar geometry of the others"
        )
    return (
        f"{_description(anomalies)}. It was decoded nevertheless: {1 - share:.0%} of the lit pixels are consistent in "
        f"themselves and with their surface, and fit one epipolar geometry to {distance:.2f} px. Did someone walk "
        "through the picture, or did the light change?"
    )


def _description(anomalies: Sequence[Anomaly]) -> str:
    return "the frames do not show what the capture says: " + "; ".join(anomaly.message for anomaly in anomalies)


def _epipolar(matches: Matches) -> tuple[float, float]:
    """The median distance of the matches from the lines of the fundamental matrix that most of them obey, in projector
    pixels; and the share of those that are far from theirs.
    """
    count = len(matches)
    chosen = np.random.default_rng(_SEED).choice(count, min(count, _MOST_MATCHES), replace=False)
    camera, projector = (np.asarray(px[chosen], np.float64) for px in (matches.camera_px, matches.projector_px))
    some = Matches(camera, projector)
    matrix = epipolar_matrix(some)
    if matrix is None:
        return 0.0, 1.0
    distance = from_epipolar_lines(some, matrix)
    sigma = np.zeros(len(chosen)) if matches.sigma_px is None else matches.sigma_px[chosen]
    outliers = np.mean(distance > np.maximum(EPIPOLAR_PX, SIGNIFICANT_SIGMAS * sigma))
    return float(np.median(distance)), float(outliers)


def epipolar_matrix(matches: Matches) -> Floats | None:
    """The fundamental matrix (3, 3) that most of the matches obey; None if there is none."""
    matrix, _ = cv2.findFundamentalMat(
        matches.camera_px, matches.projector_px, cv2.USAC_MAGSAC, EPIPOLAR_PX, 0.999, 2000
    )
    return None if matrix is None or matrix.shape != (3, 3) else np.asarray(matrix, np.float64)


def from_epipolar_lines(matches: Matches, matrix: Floats) -> Floats:
    """Distances (N,) of the projector pixels from the lines of the camera's, in projector pixels."""
    lines: Floats = np.column_stack([matches.camera_px, np.ones(len(matches))]) @ matrix.T
    distance: Floats = np.abs(np.sum(lines[:, :2] * matches.projector_px, axis=1) + lines[:, 2])
    return distance / (np.hypot(lines[:, 0], lines[:, 1]) + 1e-12)
