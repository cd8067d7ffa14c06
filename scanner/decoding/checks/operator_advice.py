"""Advice for the operator on a capture that decodes, but could be better."""

from collections.abc import Iterator

import numpy as np

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


def too_dark(levels: Image, noise: NoiseModel) -> str | None:
    """Return a sentence if the patterns hardly exceed the noise, else None.

    `levels` (frames, P): of pixels sampled from the whole image.
    """
    swing = np.ptp(levels, axis=0)
    change, bright = (float(np.quantile(values, BRIGHTEST)) for values in (swing, levels.max(axis=0)))
    ratio = change / float(noise.sigma(np.array([bright]))[0])
    if ratio >= _DARK_RATIO:
        return None
    return (
        f"The frames are too dark: even where the projector's light is brightest it is only {ratio:.2g} times the "
        f"noise of a pixel, {change:.2g} grey levels. Expose longer, open the aperture, or bring the projector closer."
    )


def warnings_of(
    reasons: Reasons, modulation: float | None, flicker: float | None, darkness: str | None = None
) -> Iterator[str]:
    """Yield warnings from the `reasons` (H, W) of all pixels, the `modulation` of the finest fringes, and the
    `flicker`.

    `darkness`: the result of `too_dark`.
    """
    if darkness is not None:
        yield darkness
    count = count_reasons(reasons, (MaskReason.KEPT, MaskReason.DARK, MaskReason.SATURATED, MaskReason.INCONSISTENT))
    matched, dark = count[MaskReason.KEPT], count[MaskReason.DARK]
    lit = max(1, reasons.size - dark)
    if matched < _FEW_MATCHED * reasons.size:
        yield f"Only {matched / reasons.size:.1%} of the camera's pixels have a match: does the camera see the light?"
    if count[MaskReason.SATURATED] > FEW * lit:
        yield f"{count[MaskReason.SATURATED] / lit:.0%} of the lit pixels are saturated: shorten the exposure."
    if count[MaskReason.INCONSISTENT] > FEW * lit:
        yield (
            f"At {count[MaskReason.INCONSISTENT] / lit:.0%} of the lit pixels the frames contradict each other: "
            "interreflection, or something moved."
        )
    if flicker is not None and flicker > MUCH_FLICKER:
        yield (
            f"The brightness of the frames varies by {flicker:.1%}, which was corrected as far as the frames show it. "
            "Better: expose for whole refresh periods of the projector, which are also whole turns of its colour "
            "wheel, and switch off other lamps."
        )
    if modulation is not None and modulation < _LOW_MODULATION:
        yield (
            f"The finest fringes are faint, {modulation:.0%} of the mean brightness: focus camera and projector, "
            "darken the room, or use a longer period."
        )
