"""Whether the lenses are sharp enough for the stripes that a scan shows, and which of them is not."""

from collections.abc import Sequence
from math import exp, pi

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats
from scanner.checking.focus import BlurSamples, Lenses
from scanner.checking.report import LEAST_AMPLITUDE, CheckRow
from scanner.patterns import Gray, Pattern, Phase

_NAME = "focus"
# Largest blur of either lens.
_LEAST_OF_BOTH = LEAST_AMPLITUDE**2
_SURE_SIGMAS = 2.0
# Share of the total blur: model error of Gaussian lenses, which the scatter does not contain.
_MODEL = 0.15
# In the device's own pixels: such a lens keeps half the contrast of stripes of two pixels, and focusing gains nothing.
_SHARP_PX = 0.7
# If stripes in a part of the picture keep this much less contrast than elsewhere, the operator is told.
_WORST_SHARE = 0.1
_MIDDLE = 1 / 6

_MOVING_PIXELS = " A projector that moves its pixels to show more of them (4K enhancement) blurs too: turn that off."

CHECKED_FOCUS = FindingKind(
    "check-focus",
    "What scan check says of the focus of both lenses.",
    "Focus the projector on the scene, then the camera, and close the aperture.",
)


def finest_period_px(patterns: Sequence[Pattern]) -> float:
    """The shortest period of a sequence in projector pixels; a Gray code's stripes are two cells to a period."""
    fringes = [pattern.period for pattern in patterns if isinstance(pattern, Phase)]
    codes = [2.0 * pattern.cell for pattern in patterns if isinstance(pattern, Gray)]
    return min(fringes or codes)


def amplitude_left(blur2: float, period_px: float) -> float:
    """Return the amplitude that a Gaussian blur of that variance, in projector pixels squared, leaves of a sine (1:
    all).
    """
    return exp(-2 * pi**2 * max(0.0, blur2) / period_px**2)


def focus_row(samples: BlurSamples, lenses: Lenses | None, period_px: float) -> CheckRow:
    """Judge the lenses by the finest period that a scan is going to show."""
    if lenses is None:
        return CheckRow(
            _NAME,
            Finding(
                CHECKED_FOCUS,
                Severity.REFUSAL if samples.lost > 0.5 else Severity.WARNING,
                "stripes are blurred away, or too few are seen to tell",
                "Focus the projector on the corner until single pixels are distinct on the wall, then the camera.",
            ),
        )
    amplitude = amplitude_left(lenses.total_px**2, period_px)
    finding = f"{100 * amplitude:.0f} % is left of stripes of {period_px:g} px, {_split_in_words(lenses)}"
    finding += _worst_in_words(samples, period_px)
    sure = _blurred(lenses, period_px, doubted=True)
    if amplitude >= _LEAST_OF_BOTH and not sure:
        return CheckRow(_NAME, Finding(CHECKED_FOCUS, Severity.NOTE, finding))
    return CheckRow(_NAME, Finding(CHECKED_FOCUS, Severity.WARNING, finding, _advice(sure, lenses, period_px)))


def _advice(sure: list[str], lenses: Lenses, period_px: float) -> str:
    if not sure and not _are_separated(lenses):
        return (
            "This view does not show which lens it is. Focus the projector until single pixels can be distinguished on "
            f"the wall, then the camera; check again after each.{_MOVING_PIXELS}"
        )
    guilty = sure or _blurred(lenses, period_px, doubted=False)
    if not guilty:
        return (
            "Both lenses are as sharp as the pixels, which are too coarse for these stripes: move the camera closer, "
            "use a camera of more pixels, or longer sequence.periods."
        )
    advice = f"Focus the {' and the '.join(guilty)}{'' if sure else ', which seems to be the one, and check again'}."
    if "camera" in guilty:
        advice += " A smaller aperture of the camera's gives more depth of focus."
    return advice + (_MOVING_PIXELS if "projector" in guilty else "")


def _blurred(lenses: Lenses, period_px: float, *, doubted: bool) -> list[str]:
    """The lenses that leave less than a lens should, in spite of all doubts (`doubted`) or in all likelihood."""
    blurred = []
    for name, part, sigma, pixel in (
        ("projector", lenses.projector2, lenses.projector2_sigma, 1.0),
        ("camera", lenses.camera2, lenses.camera2_sigma, lenses.span),
    ):
        doubt = _SURE_SIGMAS * sigma + lenses.doubt2 + _MODEL * lenses.total_px**2
        least = part - doubt if doubted else part
        # Comparisons with NaN are false: an unknown lens is not blamed.
        if amplitude_left(least, period_px) < LEAST_AMPLITUDE and least > (_SHARP_PX * pixel) ** 2:
            blurred.append(name)
    return blurred


def _are_separated(lenses: Lenses) -> bool:
    """Whether the uncertainty of the separation is smaller than the blur."""
    doubt = _SURE_SIGMAS * float(np.hypot(lenses.projector2_sigma, lenses.camera2_sigma)) + lenses.doubt2
    return doubt < max(lenses.total_px**2, lenses.projector2, lenses.camera2)


def _split_in_words(lenses: Lenses) -> str:
    total = f"a blur of {lenses.total_px:.1f} px"
    if not _are_separated(lenses):
        return f"{total}; this view does not show which lens causes it"
    projector, camera = np.sqrt(np.maximum([lenses.projector2, lenses.camera2], 0.0))
    return f"{total}: the projector's {projector:.1f}, the camera's {camera:.1f}"


def _worst_in_words(samples: BlurSamples, period_px: float) -> str:
    limit = float(np.quantile(samples.blur2, 1 - _WORST_SHARE))
    worst = amplitude_left(limit, period_px)
    usual = amplitude_left(float(np.median(samples.blur2)), period_px)
    if worst >= LEAST_AMPLITUDE * usual or usual < _LEAST_OF_BOTH:
        return ""
    middle = samples.where[samples.blur2 >= limit].mean(axis=0) - 0.5
    return f"; only {100 * worst:.0f} % {_place(middle)} of the image"


def _place(middle: Floats) -> str:
    across = ["left", "", "right"][int(np.digitize(middle[0], [-_MIDDLE, _MIDDLE]))]
    down = ["upper", "", "lower"][int(np.digitize(middle[1], [-_MIDDLE, _MIDDLE]))]
    words = " ".join(word for word in (down, across) if word)
    return f"in the {words} part" if words else "in parts"
