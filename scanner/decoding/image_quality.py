"""How good the pictures of a capture that decodes are: contrast of the finest stripes, and advice for the operator.

Interreflection, blur and the surface reduce the contrast along x and along y alike. A projector that resamples its
picture does not: where a picture pixel falls between two panel pixels, stripes across that direction lose most
contrast, in a moiré pattern over the picture.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import MANY_PIXELS, Bools, Floats, Floats32, Image, Ints, at_random
from scanner.decoding.coordinates import CodeImages, CoordinateMap
from scanner.decoding.light import STRAY_PART, NoiseModel, Sample
from scanner.decoding.mask_reasons import MaskReason, Reasons, count_reasons
from scanner.decoding.sequence_plan import AxisPlan
from scanner.decoding.significance import BRIGHTEST, FEW, HALF

_STEPS = 256  # between two pixels, for the integrals of a Fourier series


@dataclass(frozen=True)
class FinestStripes:
    """Contrast of the finest stripes at N pixels."""

    camera_px: Floats
    """(N, 2)"""
    projector_px: Floats
    """(N, 2)"""
    log_ratio: Floats
    """(N,): logarithm of the contrast along x over that along y."""
    periods: tuple[float, float]
    """(2,): of these stripes along x and y, in picture pixels."""

    def at(self, chosen: Ints) -> "FinestStripes":
        """Return a selection of the pixels."""
        return replace(
            self,
            camera_px=self.camera_px[chosen],
            projector_px=self.projector_px[chosen],
            log_ratio=self.log_ratio[chosen],
        )


def finest_stripes(code_images: CodeImages, sample: Sample, maps: CoordinateMap) -> FinestStripes | None:
    """Measure the stripes at kept pixels, of the sample if there are codes only; None if an axis has no suitable
    stripes.
    """
    x, y = code_images.plan.axes
    if x.fringes and y.fringes:
        pixels = at_random(maps.reason.size, MANY_PIXELS)
        finest = x.fringes[-1], y.fringes[-1]
        places = np.divmod(pixels, maps.reason.shape[1])
        frames = dict(code_images.frames.by_number(places, {*finest[0].frames, *finest[1].frames}))
        of_x, of_y = (
            np.hypot(*fringe.weights32 @ np.stack([frames[frame] for frame in fringe.frames], dtype=np.float32))
            for fringe in finest
        )
        return _where_kept(pixels, of_x, of_y, (finest[0].period, finest[1].period), maps)
    pixels, levels = sample.pixels, sample.levels
    column, row = maps.projector_px.reshape(-1, 2)[pixels].T
    found_x, found_y = _of_axis(x, levels, column), _of_axis(y, levels, row)
    if found_x is None or found_y is None:
        return None
    return _where_kept(pixels, found_x[0], found_y[0], (found_x[1], found_y[1]), maps)


def _where_kept(
    pixels: NDArray[np.int64], of_x: Floats32, of_y: Floats32, periods: tuple[float, float], maps: CoordinateMap
) -> FinestStripes | None:
    """Select pixels (P,) that are kept and whose contrasts (P,) are known; unknown contrast is 0."""
    projector_px = maps.projector_px.reshape(-1, 2)[pixels]
    known: Bools = np.isfinite(projector_px).all(axis=1) & (maps.reason.reshape(-1)[pixels] == MaskReason.KEPT)
    for contrast in (of_x, of_y):
        known &= contrast > 0
        if known.any():
            known &= contrast > STRAY_PART * np.max(contrast[known])
    if not known.any():
        return None
    row, column = np.divmod(pixels[known], maps.reason.shape[1])
    return FinestStripes(
        np.stack([column, row], axis=1).astype(np.float64),
        projector_px[known].astype(np.float64),
        np.log(of_x[known] / of_y[known]).astype(np.float64),
        periods,
    )


def _of_axis(axis: AxisPlan, levels: NDArray[Any], coordinate: Floats32) -> tuple[Floats32, float] | None:
    """Return the contrast (P,) of an axis's finest fringe or bit, 0 where unknown, and the period of its stripes."""
    if axis.fringes:
        fringe = axis.fringes[-1]
        return np.hypot(*fringe.weights32 @ levels[list(fringe.frames)]), fringe.period
    for code in axis.codes:
        bit = max(code.pairs, default=-1)
        if bit == code.bits - 1 and bit not in code.relative:
            normal, inverse = code.pairs[bit]
            # Of words 0, 1, 2, 3 the finest bit is set in 1 and 2.
            period = 4.0 * code.cell
            wave = np.cos(2 * np.pi * (coordinate + code.offset + 0.5 - 2 * code.cell) / period)
            known: Bools = np.abs(wave) > HALF  # midway between two stripes a bit says nothing of its contrast
            contrast = np.where(known, (levels[normal] - levels[inverse]) / np.where(known, wave, 1), 0)
            return np.maximum(contrast, 0).astype(np.float32), period
    return None


def interpolation_contrast(shift_px: Floats, period: float) -> Floats:
    """Return the log contrast that linear interpolation between two pixels leaves of a wave of this
    period in pixels.
    """
    between = shift_px - np.floor(shift_px)
    log_contrast: Floats = 0.5 * np.log(1 - 2 * between * (1 - between) * (1 - np.cos(2 * np.pi / period)))
    return log_contrast


def first_harmonics(count: int) -> Callable[[Floats, float], Floats]:
    """Return `interpolation_contrast` as a Fourier series without its mean, of `count` harmonics."""
    between = (np.arange(_STEPS) + 0.5) / _STEPS

    def series(shift_px: Floats, period: float) -> Floats:
        log_contrast = interpolation_contrast(between, period)
        total = np.zeros(len(shift_px))
        for n in range(1, count + 1):
            half_swing = 2 * np.mean(log_contrast * np.cos(2 * np.pi * n * between))
            total += half_swing * np.cos(2 * np.pi * n * shift_px)
        return total

    return series


# Below this ratio, whole surfaces are lost in noise: simulated frames decode 99 % of the lit pixels at 18, nine tenths
# at 15, half at 13 and hardly any at 11.
_DARK_RATIO = 15.0
_LOW_MODULATION = 0.2  # of the mean brightness: noise then counts five times
_FEW_MATCHED = 0.02  # of the camera's pixels
# One per cent of flicker shifts a fringe of four steps by up to 1/600 of its period.
MUCH_FLICKER = 0.01

TOO_DARK = FindingKind(
    "too-dark",
    "The projector's light hardly exceeds the camera's noise, which may be the cause of everything else.",
    "Expose longer, open the aperture, or bring the projector closer.",
    ("noise_ratio", "swing_grey_levels"),
)
FEW_MATCHES = FindingKind(
    "few-matches",
    "Hardly any pixel of the camera has a match.",
    "Point the camera at the projector's light; check lens cap, aperture and exposure.",
    ("matched_share",),
)
SATURATED = FindingKind(
    "saturated",
    "Lit pixels reach the largest value, so that they are lost.",
    "Shorten the exposure; if one wall is bright and another dark, use two exposures.",
    ("saturated_share",),
)
INCONSISTENT_PIXELS = FindingKind(
    "inconsistent-pixels",
    "At many pixels the frames contradict each other: interreflection, or something moved.",
    "Keep the scene still; between bright walls use sequence.preset=concave.",
    ("inconsistent_share",),
)
FLICKER = FindingKind(
    "flicker",
    "The brightness of the frames varies; it was corrected as far as the frames show it.",
    "Expose for whole refresh periods of the projector, which are also whole turns of its colour wheel, and switch "
    "off other lamps.",
    ("flicker_share",),
)
FAINT_FRINGES = FindingKind(
    "faint-fringes",
    "The finest fringes have little contrast, so that noise counts more.",
    "Focus camera and projector, darken the room, or use a longer period.",
    ("modulation_share",),
)


def too_dark(levels: Image, noise: NoiseModel) -> Finding | None:
    """Return a warning if the patterns hardly exceed the noise, else None.

    `levels` (frames, P): of pixels sampled from the whole image.
    """
    swing = np.ptp(levels, axis=0)
    change, bright = (float(np.quantile(values, BRIGHTEST)) for values in (swing, levels.max(axis=0)))
    ratio = change / float(noise.sigma(np.array([bright]))[0])
    if ratio >= _DARK_RATIO:
        return None
    return Finding(
        TOO_DARK,
        Severity.WARNING,
        f"The frames are too dark: even where the projector's light is brightest it is only {ratio:.2g} times the "
        f"noise of a pixel, {change:.2g} grey levels.",
        TOO_DARK.remedy,
        {"noise_ratio": ratio, "swing_grey_levels": change},
    )


def warnings_of(reasons: Reasons, modulation: float | None, flicker: float | None) -> Iterator[Finding]:
    """Yield warnings from the `reasons` (H, W) of all pixels, the `modulation` of the finest fringes, and the
    `flicker`.
    """
    count = count_reasons(reasons, (MaskReason.KEPT, MaskReason.DARK, MaskReason.SATURATED, MaskReason.INCONSISTENT))
    matched, dark = count[MaskReason.KEPT], count[MaskReason.DARK]
    lit = max(1, reasons.size - dark)
    if matched < _FEW_MATCHED * reasons.size:
        share = matched / reasons.size
        yield Finding(
            FEW_MATCHES,
            Severity.WARNING,
            f"Only {share:.1%} of the camera's pixels have a match: does the camera see the light?",
            data={"matched_share": share},
        )
    if count[MaskReason.SATURATED] > FEW * lit:
        share = count[MaskReason.SATURATED] / lit
        yield Finding(
            SATURATED,
            Severity.WARNING,
            f"{share:.0%} of the lit pixels are saturated.",
            "Shorten the exposure.",
            {"saturated_share": share},
        )
    if count[MaskReason.INCONSISTENT] > FEW * lit:
        share = count[MaskReason.INCONSISTENT] / lit
        yield Finding(
            INCONSISTENT_PIXELS,
            Severity.WARNING,
            f"At {share:.0%} of the lit pixels the frames contradict each other: interreflection, or something moved.",
            data={"inconsistent_share": share},
        )
    if flicker is not None and flicker > MUCH_FLICKER:
        yield Finding(
            FLICKER,
            Severity.WARNING,
            f"The brightness of the frames varies by {flicker:.1%}, which was corrected as far as the frames show it.",
            "Better: expose for whole refresh periods of the projector, which are also whole turns of its colour "
            "wheel, and switch off other lamps.",
            {"flicker_share": flicker},
        )
    if modulation is not None and modulation < _LOW_MODULATION:
        yield Finding(
            FAINT_FRINGES,
            Severity.WARNING,
            f"The finest fringes are faint, {modulation:.0%} of the mean brightness.",
            FAINT_FRINGES.remedy,
            {"modulation_share": modulation},
        )
