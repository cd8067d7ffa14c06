"""Tests of the decoded coordinates by the epipolar geometry: of frame anomalies, and of codes in stray light.

Whatever the devices, light or scene, the matches of one camera and one projector obey one epipolar geometry, and codes
and fringes agree with each other and with neighbouring pixels. A frame with another pattern breaks this wherever the
pattern differs. A flickering lamp does not, and a passing person only locally.

In dark parts of a scene, interreflection and subsurface scattering still have bits, some of them wrong. The contrast
below which they decide depends on scene, camera and noise: it is where codes begin to violate the geometry of the other
pixels. Pixels that were decoded without some of their bits are tested in the same way. Fringes need no such test: their
amplitude is that of direct light.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import cv2
import numpy as np

from calib.finding import Datum, Finding, Severity
from calib.geometry import Matches
from calib.numerics import Bools, Floats, Floats32, Image, at_random, chosen_ones
from scanner.decoding.constraints import FRAMES_CONTRADICT, MOST_BROKEN, suspected
from scanner.decoding.coordinates import CodeImages, Maps
from scanner.decoding.mask_reasons import BROKEN, MaskReason, Reasons, count_reasons
from scanner.decoding.significance import FEWEST_PIXELS, SIGNIFICANT_SIGMAS
from scanner.errors import FramesError, InputError

# Distance from the epipolar line in projector pixels that lens distortion or a poor sigma may cause.
EPIPOLAR_PX = 3.0
_MOST_OUTLIERS = 0.15  # largest share of matches that are farther from it
# Pixels are tested in this many steps of contrast, brightest first, until the share of outliers rises by this much.
_STEPS, _MORE_OUTLIERS = 20, 0.25
_FEWEST = _STEPS * FEWEST_PIXELS


@contextmanager
def annotate_errors(anomalies: Sequence[Finding]) -> Iterator[None]:
    """Prepend the anomalies to the message of an InputError that is raised in the block."""
    try:
        yield
    except InputError as error:
        if not anomalies:
            raise
        raise _inconsistent(anomalies, f"and {error}") from error


def assess_anomalies(
    anomalies: Sequence[Finding], reasons: Reasons, matches: Matches, *, one_axis: bool = False
) -> Finding:
    """Return one warning about anomalies that do no harm, from the `reasons` (H, W) of all pixels.

    `one_axis`: whether matches were placed on the lines of an epipolar geometry, which therefore cannot test them.

    Raises InputError if the anomalies do harm.
    """
    counts = count_reasons(reasons, (MaskReason.KEPT, *BROKEN))
    broken = int(sum(counts[reason] for reason in BROKEN))
    share = broken / max(1, broken + int(counts[MaskReason.KEPT]))
    if share > MOST_BROKEN:
        raise _inconsistent(
            anomalies,
            f"and {share:.0%} of the lit pixels are inconsistent in themselves or with their surface: did something "
            "move in most of the picture, or were frames exchanged?",
        )
    if len(matches) < FEWEST_PIXELS:
        return _harmless(anomalies, "Too few pixels have a match to assess the effect.")
    if one_axis:
        return _harmless(
            anomalies,
            f"It was decoded nevertheless: {1 - share:.0%} of the lit pixels are consistent.",
            {"consistent_share": 1 - share},
        )
    distance, outliers = _epipolar(matches)
    if outliers > _MOST_OUTLIERS:
        raise _inconsistent(
            anomalies,
            f"and {outliers:.0%} of the matches are more than {EPIPOLAR_PX:g} projector pixels from the epipolar "
            "geometry of the others",
        )
    return _harmless(
        anomalies,
        f"It was decoded nevertheless: {1 - share:.0%} of the lit pixels are consistent in themselves and with their "
        f"surface, and fit one epipolar geometry to {distance:.2f} px. Did someone walk through the picture, or did "
        "the light change?",
        {"consistent_share": 1 - share, "epipolar_px": distance},
    )


def _harmless(anomalies: Sequence[Finding], effect: str, data: Mapping[str, Datum] | None = None) -> Finding:
    frames = tuple(sorted(suspected(anomalies)))
    message = f"{_description(anomalies)}. {effect}"
    return Finding(FRAMES_CONTRADICT, Severity.WARNING, message, data={"frames": frames, **(data or {})})


def _inconsistent(anomalies: Sequence[Finding], effect: str) -> FramesError:
    further = [anomaly.message for anomaly in anomalies[1:]]
    return FramesError(_description(anomalies[:1]), "; ".join([*further, effect]))


def _description(anomalies: Sequence[Finding]) -> str:
    return "the frames do not show what the capture says: " + "; ".join(anomaly.message for anomaly in anomalies)


def _epipolar(matches: Matches) -> tuple[float, float]:
    """Return the median distance of the matches from their epipolar lines, in projector pixels, and the share of
    outliers.
    """
    chosen = at_random(len(matches))
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
    """Estimate the fundamental matrix (3, 3) of the matches robustly (MAGSAC); None if there is none."""
    matrix, _ = cv2.findFundamentalMat(
        matches.camera_px, matches.projector_px, cv2.USAC_MAGSAC, EPIPOLAR_PX, 0.999, 2000
    )
    return None if matrix is None or matrix.shape != (3, 3) else np.asarray(matrix, np.float64)


def from_epipolar_lines(matches: Matches, matrix: Floats) -> Floats:
    """Return the distances (N,) of projector pixels from the camera pixels' epipolar lines, in projector pixels."""
    lines: Floats = np.column_stack([matches.camera_px, np.ones(len(matches))]) @ matrix.T
    distance: Floats = np.abs(np.sum(lines[:, :2] * matches.projector_px, axis=1) + lines[:, 2])
    return distance / (np.hypot(lines[:, 0], lines[:, 1]) + 1e-12)


def leave_out_stray_light(code_images: CodeImages, maps: Maps) -> None:
    """Mask, in place, pixels without fringes whose contrast is too low for reliable codes."""
    plan = code_images.plan
    contrasts = [code_words.contrast for code_words in code_images.codes if code_words.contrast is not None]
    if plan.fringes or plan.only_axis is not None or not contrasts:
        return
    contrast: Image = np.min(contrasts, axis=0)
    kept = maps.reason == np.uint8(MaskReason.KEPT)
    # Pixels with all their bits have the variance of a cell.
    partial = kept & (maps.variance > np.float32(1.01 * sum(axis.cell**2 for axis in plan.axes) / 24))
    whole = kept & ~partial
    if np.count_nonzero(whole) < _FEWEST:
        return
    # From all pixels: the brightest may lie in a plane, which leaves the geometry undetermined.
    matrix = epipolar_matrix(_matches(_some(whole), maps))
    if matrix is None:
        return
    usual = 0.0
    for group in (whole, partial):
        row, column = places = _some(group)
        if len(row) < _FEWEST:
            continue
        is_outlier = from_epipolar_lines(_matches(places, maps), matrix) > EPIPOLAR_PX
        levels = contrast[row, column].astype(np.float32)
        if group is whole:
            usual = float(np.mean(is_outlier[levels >= np.median(levels)]))
        faintest = _faintest(levels, is_outlier, usual)
        np.copyto(maps.reason, np.uint8(MaskReason.UNDECIDED), where=group & (contrast < faintest))


def _faintest(contrast: Floats32, is_outlier: Bools, usual: float) -> float:
    """Return the lowest contrast down to which `is_outlier` (P,) is no more frequent than usual; ∞ if there is none."""
    order = np.argsort(-contrast, kind="stable")
    faintest = float(np.inf)
    for step in np.array_split(order, _STEPS):
        if np.mean(is_outlier[step]) > usual + _MORE_OUTLIERS:
            return faintest
        faintest = float(contrast[step].min())
    return 0.0


def _some(chosen: Bools) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of some of the chosen pixels (H, W)."""
    row, column = np.divmod(chosen_ones(chosen, at_random(int(np.count_nonzero(chosen)))), chosen.shape[1])
    return row, column


def _matches(places: tuple[np.ndarray, np.ndarray], maps: Maps) -> Matches:
    row, column = places
    camera_px: Floats = np.stack([column, row], axis=1).astype(np.float64)
    return Matches(camera_px, maps.projector_px[row, column].astype(np.float64))
