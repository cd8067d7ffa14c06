"""Advice for the operator on a capture that decodes, but could be better."""

from collections.abc import Iterator

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Image
from scanner.decoding.light import NoiseModel
from scanner.decoding.mask_reasons import MaskReason, Reasons, count_reasons
from scanner.decoding.significance import BRIGHTEST, FEW

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
