"""Blur of the two lenses, from the contrast of short fringes relative to long ones.

A Gaussian blur of standard deviation σ leaves exp(−2π²σ²/λ²) of a fringe of period λ (its modulation transfer). The
projector's blur is constant in projector pixels. The camera's, in projector pixels, grows with the span of a camera
pixel across the stripes. The span differs between the axes and between the faces of a corner, which separates the two
lenses: blur² = projector² + camera² · span².

Whether the lenses are sharp enough for the stripes that a scan shows, and which of them is not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp, pi

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Bools, Floats, Ints, fit_reweighted, huber_weights, robust_sigma
from scanner.checking.fringes import FringePower, cell_size
from scanner.checking.report import LEAST_AMPLITUDE, CheckRow
from scanner.patterns import Axis, Gray, Pattern, Phase

# Least power of a fringe relative to the noise of its mean.
_SEEN = 5.0
_FEWEST_OF_CELL = 0.5
# A cell across an edge shows more than one plane.
_STRAIGHT_PX = 0.5
_FEWEST_CELLS = 12
# Least camera pixels per period: with fewer, the amplitude is sampled too coarsely.
_CAMERA_PIXELS = 3.0
# Model error of a fringe's amplitude: pixels are not exactly squares, and lenses not Gaussians.
_MODEL_ERROR = 0.03
_BLOCKS = 4
_HUBER_SIGMAS = 1.345  # for 95 % efficiency with normal errors
_ROUNDS = 10
# Additional to the quick sequence: periods that projectors can draw as sines, and one that hardly any lens blurs. They
# are not whole numbers, as in the presets.
_SHORT_PERIODS_PX = (4.3, 6.1, 8.6)
LONG_PERIOD_PX = 24.6
# Factor by which a camera pixel spans more than on average on oblique faces.
_UNEVEN = 1.3
_AXES: tuple[Axis, Axis] = ("x", "y")
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


@dataclass(frozen=True)
class BlurSamples:
    """Blur of cells of the camera's image, each along one axis."""

    blur2: Floats
    """In projector pixels squared, (N,)."""
    span: Floats
    """Projector pixels per camera pixel across the stripes, (N,)."""
    where: Floats
    """The cell's centre in the camera's image, 0 … 1 from left to right and from top to bottom, (N, 2)."""
    doubt2: Floats
    """What of `blur2` a lens that is no Gaussian may have made up, (N,)."""
    lost: float
    """Share of the cells in which even the longest fringes of a pair were gone."""


def sample_blur(fringes: Mapping[tuple[Axis, float], FringePower], usable: Bools, projector_px: Floats) -> BlurSamples:
    """Measure blur from fringes of two or more periods, where pixels are `usable` (H, W) and `projector_px` (H, W, 2)
    is known.
    """
    height, width = usable.shape
    size = cell_size(usable.shape)
    blur2, span, where, doubt2 = [], [], [], []
    cells = 0
    for top in range(0, height - size + 1, size):
        for left in range(0, width - size + 1, size):
            part = np.s_[top : top + size, left : left + size]
            good = usable[part] & np.isfinite(projector_px[part]).all(axis=2)
            if good.mean() < _FEWEST_OF_CELL:
                continue
            slope = _slope(projector_px[part], good)
            if slope is None:
                continue
            for number, axis in enumerate(_AXES):
                cells += 1
                blur_estimate = _blur2(fringes, axis, part, good, slope[number])
                if blur_estimate is not None:
                    blur2.append(blur_estimate[0])
                    doubt2.append(blur_estimate[1])
                    span.append(float(np.linalg.norm(slope[number])))
                    where.append([(left + size / 2) / width, (top + size / 2) / height])
    lost = 1 - len(blur2) / cells if cells else 0.0
    return BlurSamples(np.array(blur2), np.array(span), np.array(where).reshape(-1, 2), np.array(doubt2), lost)


def _slope(projector_px: Floats, good: Bools) -> Floats | None:
    """Projector pixels per camera pixel, (2, 2), one row per projector axis; None without a plane."""
    row, column = np.nonzero(good)
    design = np.stack([np.ones(len(row)), column - column.mean(), row - row.mean()], axis=1)
    target = projector_px[good]
    solution, *_ = np.linalg.lstsq(design, target, rcond=None)
    off = np.abs(target - design @ solution).max(axis=1)
    slope: Floats = solution[1:].T
    return slope if np.median(off) < _STRAIGHT_PX else None


def period_for(span: float) -> float:
    """The shortest useful period in projector pixels, for this mean number of projector pixels per camera pixel."""
    return next((period for period in _SHORT_PERIODS_PX if period >= _CAMERA_PIXELS * _UNEVEN * span), LONG_PERIOD_PX)


def _blur2(
    fringes: Mapping[tuple[Axis, float], FringePower], axis: Axis, part: tuple[slice, slice], good: Bools, slope: Floats
) -> tuple[float, float] | None:
    """Squared blur and its uncertainty, from the two shortest neighbouring periods that are resolved in a cell.

    None if no two are.
    """
    resolved_px = _CAMERA_PIXELS * float(np.linalg.norm(slope))
    periods = sorted(period for direction, period in fringes if direction == axis and period >= resolved_px)
    powers = {period: _power(fringes[axis, period], part, good) for period in periods}
    for short, long in pairwise(periods):
        short_power, long_power = powers[short], powers[long]
        if short_power is None or long_power is None:
            continue
        # Pixels are squares; their own blur is not the lens's.
        expected = _squares(short, slope) / _squares(long, slope)
        transfer = np.sqrt(short_power / long_power) / expected
        lever = 2 * np.pi**2 * (1 / short**2 - 1 / long**2)
        return float(-np.log(transfer) / lever), _MODEL_ERROR / lever
    return None


def _power(fringe: FringePower, part: tuple[slice, slice], good: Bools) -> float | None:
    power, noise = fringe.power[part][good], fringe.noise[part][good]
    excess = float(power.mean() - noise.mean())
    uncertain = float(np.sqrt((power.var() + noise.var()) / len(power)))
    # Neighbouring pixels of a fringe have nearly the same power, so its scatter is mostly noise.
    return excess if excess > _SEEN * uncertain else None


def _squares(period: float, slope: Floats) -> float:
    """Return the amplitude that remains of a fringe after averaging over a projector pixel and a camera pixel."""
    return float(np.sinc(1 / period) * np.prod(np.sinc(slope / period)))


@dataclass(frozen=True)
class Lenses:
    """Blur of both lenses, and the share of each."""

    total_px: float
    """Median of both together, in projector pixels."""
    projector2: float
    """Contribution to the square of the total; NaN if the view does not separate the two."""
    camera2: float
    """The same of the camera."""
    projector2_sigma: float
    """Standard deviation of `projector2`."""
    camera2_sigma: float
    """Standard deviation of `camera2`."""
    doubt2: float
    """Error of the separation if the lenses are not Gaussian."""
    span: float
    """Projector pixels per camera pixel, median."""


def separate_lenses(samples: BlurSamples) -> Lenses | None:
    """Split the blur by least squares, with a jackknife over blocks of the image; None if there are too few samples."""
    if len(samples.blur2) < _FEWEST_CELLS:
        return None
    total2 = float(np.median(samples.blur2))
    usual = float(np.median(samples.span**2))
    block = (samples.where * _BLOCKS).astype(np.int32).clip(0, _BLOCKS - 1)
    number: Ints = block[:, 1] * _BLOCKS + block[:, 0]
    groups = np.unique(number)
    total_px = float(np.sqrt(max(0.0, total2)))
    # The attribution of blur that grows with the span is less certain if the spans differ little.
    lever = float(np.std(samples.span**2) / usual)
    doubt2 = float(np.median(samples.doubt2)) / lever if lever > 0 else float("inf")
    if len(groups) < 3:
        unknown = float("nan")
        return Lenses(total_px, unknown, unknown, unknown, unknown, doubt2, float(np.sqrt(usual)))
    parts = np.array([_split(samples, number != group, usual) for group in groups])
    # Jackknife (Efron and Tibshirani 1993, eq. 11.5).
    spread = np.sqrt((len(groups) - 1) / len(groups) * np.sum((parts - parts.mean(axis=0)) ** 2, axis=0))
    projector2, camera2 = _split(samples, np.ones(len(number), np.bool_), usual)
    return Lenses(
        total_px, float(projector2), float(camera2), float(spread[0]), float(spread[1]), doubt2, float(np.sqrt(usual))
    )


def _split(samples: BlurSamples, chosen: Bools, usual: float) -> Floats:
    """(projector's, camera's) part of the squared blur at a span whose square is `usual`."""
    relative = samples.span[chosen] ** 2 / usual
    terms = np.stack([np.ones(len(relative)), relative])
    # Cells across edges lose their weight.
    return fit_reweighted(terms, samples.blur2[chosen], _weigh, np.ones(len(relative)), _ROUNDS)


def _weigh(residual: Floats) -> Floats:
    return huber_weights(np.abs(residual), _HUBER_SIGMAS * (robust_sigma(residual) + 1e-9))


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
