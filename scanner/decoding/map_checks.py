"""Checks of the decoded coordinates: whether each frame shows the pattern that the capture states, and stray light.

Fringes that run backwards decode like any others. But fringes must agree with the Gray code and with each other. Camera
and projector see the same side of a surface, so that the map between them is never mirrored.

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
from itertools import pairwise
from math import sqrt

import cv2
import numpy as np

from calib.finding import Datum, Finding, Severity
from calib.geometry import Matches
from calib.numerics import MANY_PIXELS, Bools, Floats, Floats32, Image, Ints, at_random, chosen_ones, lines_of
from scanner.decoding.coordinates import CodeImages, CoordinateMap, FringeAxis, UnwrappedFringes, agreeing
from scanner.decoding.fringes import disagreements
from scanner.decoding.light import FRAMES_CONTRADICT, MOST_BROKEN, anomaly, suspected
from scanner.decoding.mask_reasons import BROKEN, MaskReason, Reasons, count_reasons
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS, HALF, SIGNIFICANT_SIGMAS
from scanner.errors import FramesError, InputError

# Mean cosine of the phase within a Gray cell; fringes for which it is lower are not checked.
_INFORMATIVE = 0.3
# Unrelated fringes reach no more than this share of the expected cosine, and differ by a quarter of a cycle in the
# median; a rippled phase differs by 0.06. Fringe orders are right as long as the difference is below half a cycle.
_UNRELATED = 0.2
# Largest share of neighbours that are whole periods apart, and how nearly. At rest, occlusion edges cause 0.03 %; a
# code that is a quarter of a period off its fringes causes 3 %.
_MOST_SLIPS = 0.01
_NEARLY = 0.25
_MOST_BAD = 0.6  # of the lit pixels: a wrong frame makes half and more of them contradict


def check_fringes(plan: SequencePlan, decoder: FringeAxis, measured: UnwrappedFringes) -> Iterator[Finding]:
    """Yield anomalies where the fringes of an axis agree poorly with its Gray code or with each other, on a sample
    that was `measured` with the widest tolerances.

    Raises InputError if they do not agree at all.
    """
    axis, interval = decoder.plan, measured.interval
    lit = measured.well_lit & interval.possible
    if np.any(lit):
        # Slightly wrong gains of a lamp leave a fringe where there is only ambient light.
        power = measured.power(0)
        lit &= power > FEW**2 * np.quantile(power[lit], BRIGHTEST)
    if np.count_nonzero(lit) < FEWEST_PIXELS:
        return
    for fringe, position in zip(axis.fringes[: decoder.finest + 1], measured.orders.coordinates, strict=False):
        expected = float(np.sinc(axis.cell / fringe.period))
        cosine = np.mean(np.cos(2 * np.pi / fringe.period * (position - interval.centre)[lit]))
        if axis.codes and axis.cell < fringe.period and expected > _INFORMATIVE and cosine < HALF * expected:
            if cosine < _UNRELATED * expected:
                raise FramesError(
                    f"the fringes of {plan.names(fringe.frames)} do not follow the Gray code along {axis.axis}",
                    f"were some of these frames exchanged{_or_code(plan, axis)}?",
                )
            yield anomaly(
                f"the fringes of {plan.names(fringe.frames)} follow the Gray code along {axis.axis} badly",
                fringe.frames,
            )
    between_px = disagreements(measured.orders, interval, agreeing(measured)).between_px
    for (longer, shorter), distance in zip(pairwise(axis.fringes[: decoder.finest + 1]), between_px, strict=False):
        apart = float(np.median(distance))
        if apart <= FEW * shorter.period:
            continue
        frames = (*longer.frames, *shorter.frames)
        message = (
            f"along {axis.axis} the fringes of period {longer.period:g} and {shorter.period:g} px contradict each "
            f"other by {apart:.1f} px: {plan.names(frames)}"
        )
        if apart > _UNRELATED * shorter.period:
            raise InputError(
                f"{message}. Were some of these exchanged{_or_code(plan, axis)}? Or do the projector's gamma or "
                "interreflection bend the fringes so much that more shifts or shorter periods are needed?"
            )
        yield anomaly(message, frames)


def check_cycles(plan: SequencePlan, projector_px: Floats32) -> None:
    """Raise InputError if too many neighbours in the coordinates (H, W, 2) are whole periods apart.

    With a single fringe, a code that was shown before a motion, that belongs to another capture or that runs backwards
    selects the wrong period near the borders of its cells. No pixel by itself looks wrong.
    """
    for number, axis in enumerate(plan.axes):
        if not (axis.codes and axis.fringes):
            continue
        # Two periods, as if the code ran backwards, may agree with a second fringe as well.
        slips, period = (2,) if axis.corrects_bits else (1, 2), axis.fringes[0].period
        share = max(_apart(projector_px[..., number], slip * period, period) for slip in slips)
        if share > _MOST_SLIPS:
            frames = [frame for code in axis.codes for frame in code.frames]
            raise InputError(
                f"along {axis.axis} {share:.1%} of all neighbouring pixels are whole periods of the fringes apart: the "
                f"code of {plan.name(min(frames))} to {plan.name(max(frames))} is not that of the fringes. Did "
                "something move in between, or were frames exchanged?"
            )


def _apart(coordinate: Floats32, px: float, period: float) -> float:
    """Return the share of neighbours along some lines of an image (H, W) that are about `px` apart."""
    steps = np.concatenate([np.abs(np.diff(lines_of(image), axis=1)).ravel() for image in (coordinate, coordinate.T)])
    apart = int(np.count_nonzero(np.abs(steps - np.float32(px)) < _NEARLY * period))  # NaN is not
    return apart / max(int(np.count_nonzero(np.isfinite(steps))), 1)


class MirroredError(InputError):
    """The map from camera to projector is mirrored."""


def check_maps(plan: SequencePlan, maps: CoordinateMap) -> None:
    """Raise InputError if most of what is lit is inconsistent, MirroredError if the map is mirrored."""
    kept = maps.masked_as(MaskReason.KEPT)
    for axis, counts in zip(plan.axes, maps.counts, strict=True):
        _check_share(plan, axis, counts, int(np.count_nonzero(kept)))
    mirrored = None if plan.only_axis else _mirrored_axis(plan, maps, kept)
    if mirrored is not None:
        frames = [frame for fringe in mirrored.fringes for frame in fringe.frames] or mirrored.frames
        raise MirroredError(
            f"the {mirrored.axis} coordinate runs backwards, as if seen in a mirror. Does the projector mirror its "
            "picture, as for rear projection? Then switch that off; or were frames exchanged, perhaps "
            f"{plan.names(frames)}{_or_code(plan, mirrored)}?"
        )


def _check_share(plan: SequencePlan, axis: AxisPlan, counts: Ints, kept: int) -> None:
    for reasons, what in (
        ([MaskReason.INCONSISTENT, MaskReason.INDIRECT], "the frames contradict each other"),
        ([MaskReason.OUTSIDE], f"the codes are outside the projector's 0 … {axis.length - 1}"),
    ):
        bad = int(counts[reasons].sum())
        if bad > FEWEST_PIXELS and bad > _MOST_BAD * (bad + kept):
            raise FramesError(
                f"along {axis.axis} {what} at {bad / (bad + kept):.0%} of the lit pixels",
                f"were frames exchanged, or is the projector's size wrong? {plan.names(axis.frames)}",
            )


def _mirrored_axis(plan: SequencePlan, maps: CoordinateMap, kept: Bools) -> AxisPlan | None:
    """Return the axis that runs backwards, if the map from camera to projector is mirrored at most pixels."""
    reach = max(_reach(axis, kept.shape) for axis in plan.axes)
    if 2 * reach >= min(kept.shape):
        return None
    stride = max(1, round(sqrt(kept.size / MANY_PIXELS)))
    near, far, inner = np.s_[: -2 * reach : stride], np.s_[2 * reach :: stride], np.s_[reach:-reach:stride]
    to_left, right, above, below = (inner, near), (inner, far), (near, inner), (far, inner)
    whole = kept[to_left] & kept[right] & kept[above] & kept[below]
    if np.count_nonzero(whole) < FEWEST_PIXELS:
        return None
    x_u, y_u = ((value[right] - value[to_left])[whole] for value in np.moveaxis(maps.projector_px, 2, 0))
    x_v, y_v = ((value[below] - value[above])[whole] for value in np.moveaxis(maps.projector_px, 2, 0))
    if np.mean(x_u * y_v < x_v * y_u) <= 0.5:
        return None
    # Devices are assumed roughly upright: the axis that runs against the camera's own is the mirrored one.
    return plan.x if np.median(x_u) < 0 or np.median(y_v) > 0 else plan.y


def _reach(axis: AxisPlan, shape: tuple[int, ...]) -> int:
    """Return the distance in camera pixels over which a coordinate changes by more than its resolution."""
    step = 1.0 if axis.fringes else 2 * axis.cell
    return max(1, round(step * max(shape) / axis.length))


def _or_code(plan: SequencePlan, axis: AxisPlan) -> str:
    """Return a phrase that names the frames of the Gray code as further suspects."""
    frames = [frame for code in axis.codes for frame in code.frames]
    if not frames or not axis.fringes:
        return ""
    return f", or frames of the Gray code (between {plan.name(min(frames))} and {plan.name(max(frames))})"


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
        further = [anomaly.message for anomaly in anomalies[1:]]
        raise FramesError(_description(anomalies[:1]), "; ".join([*further, f"and {error}"])) from error


def assess_anomalies(
    anomalies: Sequence[Finding], reasons: Reasons, matches: Matches, *, one_axis: bool = False
) -> Finding | None:
    """Return one warning about anomalies that do no harm, from the `reasons` (H, W) of all pixels; None without any.

    `one_axis`: whether matches were placed on the lines of an epipolar geometry, which therefore cannot test them.

    Raises InputError if the anomalies do harm.
    """
    if not anomalies:
        return None
    counts = count_reasons(reasons, (MaskReason.KEPT, *BROKEN))
    broken = int(sum(counts[reason] for reason in BROKEN))
    share = broken / max(1, broken + int(counts[MaskReason.KEPT]))
    if share > MOST_BROKEN:
        raise InputError(
            f"{share:.0%} of the lit pixels are inconsistent in themselves or with their surface: did something move "
            "in most of the picture, or were frames exchanged?"
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
        raise InputError(
            f"{outliers:.0%} of the matches are more than {EPIPOLAR_PX:g} projector pixels from the epipolar geometry "
            "of the others"
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


def mask_stray_light(code_images: CodeImages, maps: CoordinateMap) -> CoordinateMap:
    """Return the map with those pixels without fringes masked whose contrast is too low for reliable codes."""
    plan = code_images.plan
    contrasts = [code_words.contrast for code_words in code_images.codes if code_words.contrast is not None]
    if plan.fringes or plan.only_axis is not None or not contrasts:
        return maps
    contrast: Image = np.min(contrasts, axis=0)
    kept = maps.masked_as(MaskReason.KEPT)
    # Pixels with all their bits have the variance of a cell.
    partial = kept & (maps.variance > np.float32(1.01 * sum(axis.cell**2 for axis in plan.axes) / 24))
    whole = kept & ~partial
    if np.count_nonzero(whole) < _FEWEST:
        return maps
    # From all pixels: the brightest may lie in a plane, which leaves the geometry undetermined.
    matrix = epipolar_matrix(_matches(_some(whole), maps))
    if matrix is None:
        return maps
    usual, unreliable = 0.0, np.zeros_like(kept)
    for group in (whole, partial):
        row, column = places = _some(group)
        if len(row) < _FEWEST:
            continue
        is_outlier = from_epipolar_lines(_matches(places, maps), matrix) > EPIPOLAR_PX
        levels = contrast[row, column].astype(np.float32)
        if group is whole:
            usual = float(np.mean(is_outlier[levels >= np.median(levels)]))
        faintest = _faintest(levels, is_outlier, usual)
        unreliable |= group & (contrast < faintest)
    return maps.masked(unreliable, MaskReason.UNDECIDED)


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


def _matches(places: tuple[np.ndarray, np.ndarray], maps: CoordinateMap) -> Matches:
    row, column = places
    camera_px: Floats = np.stack([column, row], axis=1).astype(np.float64)
    return Matches(camera_px, maps.projector_px[row, column].astype(np.float64))
