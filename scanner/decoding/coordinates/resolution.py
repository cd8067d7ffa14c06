"""Drop what the lenses do not resolve: bits of a Gray code, whose longer cells are decoded instead, and fringes.

A bit is weak where its contrast is a small share of the coarse bits' contrast at the same pixel. It then follows
sharpening, crosstalk and stray light rather than the pattern. Weak bits are dropped if that decides more pixels than
their finer cells are worth, or if it makes neighbouring cells adjacent. Where camera pixels are larger than cells, so
that most of them lack some bit, each pixel uses the bits that it has.

Interreflection weakens fringes and stripes alike, relative to white. Lens blur weakens fringes more than the middle of
a stripe, which separates the two.
"""

from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats32, Image, evenly_spread, lines_of
from scanner.decoding.codes import CodeWords, cell_numbers, check_codes
from scanner.decoding.coordinates.axis_decoder import largest_variance, least_contrasts
from scanner.decoding.coordinates.code_images import CodeImages, Signals, signals_of
from scanner.decoding.light import STRAY_PART, NoiseModel, Sample
from scanner.decoding.sequence_plan import AxisPlan
from scanner.decoding.significance import BRIGHTEST, FARTHEST_PX, FEW, FEWEST_PIXELS, HALF, NEARLY_ALL
from scanner.errors import InputError

# Least 90 % quantile of a bit's contrast relative to the coarse bits': half of it is lost midway between two stripes
# anyway. An exchanged frame does not make a bit weak.
_WEAK = 0.25
# Blurs that are distinguished: the largest leaves hardly any of the stripes.
_BLURS_CELLS = np.linspace(0.01, 2.0, 200)
# The blur of lenses in focus is not corrected: underestimating the direct light would mask more doubtful bits.
_IN_FOCUS = 1.5

UNRESOLVED_BITS = FindingKind(
    "unresolved-bits",
    "The finest bits of a Gray code are too fine for the lenses; longer cells were decoded instead.",
    "Focus camera and projector, or move closer.",
    ("bits", "cell_px"),
)
BLURRED_FRINGES = FindingKind(
    "blurred-fringes",
    "The fringes are blurred away; the cells of the Gray code were decoded instead.",
    "Focus camera and projector.",
    ("cell_px",),
)


def resolve_bits(code_images: CodeImages, noise: NoiseModel, pixels: NDArray[np.int64]) -> Iterator[Finding]:
    """Drop the bits that are not resolved at sample pixels (P,); yield a warning for each code."""
    chosen = []
    for code_words in code_images.codes:
        resolved, count = _resolved(code_images, code_words, noise, pixels) if code_words.fine else (code_words, 0)
        chosen.append(resolved)
        if count:
            code = code_words.code
            bits, cell = range(code.bits - count, code.bits), chosen[-1].code.cell
            yield Finding(
                UNRESOLVED_BITS,
                Severity.WARNING,
                f"Bit {', '.join(map(str, bits))} of the Gray code along {code.axis} is too fine for the lenses and "
                f"was left out: cells of {cell} px are decoded.",
                UNRESOLVED_BITS.remedy,
                {"bits": tuple(bits), "cell_px": float(cell)},
            )
    code_images.decode_as(chosen)


def _resolved(
    code_images: CodeImages, code_words: CodeWords, noise: NoiseModel, pixels: NDArray[np.int64]
) -> tuple[CodeWords, int]:
    """Return the code to decode, and the number of bits dropped."""

    def at(image: Image) -> Image:
        return image.reshape(-1)[pixels]

    contrast = at(code_words.least if code_words.contrast is None else code_words.contrast)
    certain_from, seen_from = least_contrasts(noise, at(code_images.threshold))
    lit = contrast > seen_from
    if np.count_nonzero(lit) < FEWEST_PIXELS:
        return code_words.without_finest(0), 0
    weak = 0
    for bit in sorted(code_words.fine, reverse=True):
        if np.quantile(at(code_words.fine[bit])[lit] / contrast[lit], NEARLY_ALL) >= _WEAK:
            break
        weak += 1
    bits = code_words.code.bits
    # A cell twice as long is worth a quarter, as its variance is four times as large.
    decided = [
        float(np.mean(code_words.least_at(bits - count, pixels)[lit] > certain_from[lit])) for count in range(weak + 1)
    ]
    count = _count_left_out(
        code_images, code_words, noise, range(int(np.argmax(np.array(decided) / 4.0 ** np.arange(weak + 1))), weak)
    )
    # A bit is undecided at the edge of its stripe: where pixels are larger than cells, nearly all are near an edge.
    few = decided[count] < NEARLY_ALL
    return code_words.without_finest(
        count, optional=few and _cells_per_pixel(code_images, code_words, noise) > 1
    ), count


def _cells_per_pixel(code_images: CodeImages, code_words: CodeWords, noise: NoiseModel) -> float:
    """Return the median number of finest cells between adjacent camera pixels."""
    squares = 0.0
    for is_transposed in (False, True):
        words, least, threshold = (
            lines_of(image.T if is_transposed else image)
            for image in (code_words.words, code_words.least, code_images.threshold)
        )
        number = cell_numbers(words).astype(np.float32)
        certain = least > least_contrasts(noise, threshold)[0]
        both = certain[:, FARTHEST_PX:] & certain[:, :-FARTHEST_PX]
        apart = np.abs(number[:, FARTHEST_PX:] - number[:, :-FARTHEST_PX])[both]
        squares += float(np.median(apart)) ** 2 if apart.size else 0.0
    return float(np.sqrt(squares)) / FARTHEST_PX


def _count_left_out(code_images: CodeImages, code_words: CodeWords, noise: NoiseModel, counts: range) -> int:
    """Return the least of these numbers of bits to drop such that cells that differ in one bit are adjacent, or the
    next number.
    """
    for count in counts:
        coarser = [code_words.without_finest(count)]
        try:
            if not check_codes(code_images.plan, coarser, noise, code_images.threshold, code_images.white):
                return count
        except InputError:
            continue
    return counts.stop


def drop_lost_fringes(code_images: CodeImages, noise: NoiseModel, sample: Sample) -> Iterator[Finding]:
    """Drop all fringes if blur leaves hardly any on an axis with a code, judged by a sample; yield a warning."""
    pixels = evenly_spread(sample.pixels)
    signals = signals_of(
        code_images, lambda image: image.reshape(1, -1)[:, pixels], lambda frame: evenly_spread(sample.level(frame))
    )
    lost = [
        axis
        for axis, of_axis in zip(code_images.plan.axes, signals, strict=True)
        if axis.codes and axis.fringes and _is_lost(axis, of_axis, code_images, noise, sample)
    ]
    if lost and all(axis.codes for axis in code_images.plan.axes):
        code_images.forget_fringes()
        cell = max(axis.cell for axis in lost)
        yield Finding(
            BLURRED_FRINGES,
            Severity.WARNING,
            f"The fringes along {' and '.join(axis.axis for axis in lost)} are blurred away and were left out: cells "
            f"of the Gray code of {cell:g} px are decoded.",
            BLURRED_FRINGES.remedy,
            {"cell_px": float(cell)},
        )


def _is_lost(axis: AxisPlan, signals: Signals, code_images: CodeImages, noise: NoiseModel, sample: Sample) -> bool:
    certain_from, seen_from = least_contrasts(noise, signals.threshold)
    # Light from other surfaces may lie on one side of the threshold in all bits without an inverse, as by a tone curve:
    # only where fine bits differ are their stripes seen.
    fine = sorted({frame for code in axis.codes for frame in code.fine_frames})
    least = np.ptp([evenly_spread(sample.level(frame)) for frame in fine], axis=0)
    for code_words in code_images.codes:
        if code_words.code in axis.codes:
            least = np.minimum(least, code_words.least.reshape(-1)[evenly_spread(sample.pixels)])
    # Ambient light that was switched on decides bits at unlit pixels, too.
    half_lit = signals.white - signals.threshold
    # Stray light, which cameras of many bits detect, has no fringes either.
    lit = half_lit > STRAY_PART * np.quantile(half_lit, BRIGHTEST)
    decided = (least > certain_from) & (2 * half_lit > seen_from) & lit
    if np.count_nonzero(decided) < FEWEST_PIXELS:
        return False
    cosine, sine = signals.fringe(0)
    fringe = axis.fringes[0]
    variance = (fringe.period / (2 * np.pi) * fringe.noise_gain) ** 2 * noise.variance(signals.threshold)
    power = cosine**2 + sine**2
    # Motion adds noise and breaks fringes, but leaves their amplitude.
    visible = (variance <= largest_variance(fringe, with_gray=True) * power) | (power > (FEW * half_lit) ** 2)
    # It would leave out most of the pixels that decode all bits.
    return bool(np.mean(visible[decided]) < HALF)


def weakened(axis: AxisPlan, least: Floats32, amplitude: Floats32) -> float:
    """Return the factor by which lens blur weakens the longest fringe; at least 1.

    From the smallest contrast (P,) of the bits and the fringe's amplitude (P,) at lit pixels. A blur of σ leaves
    exp(−2π²σ²/λ²) of a fringe, and erf(d / √2 σ) of the contrast at a distance d from an edge.
    """
    if not len(least):
        return 1.0
    # Nearly all pixels are nearer to an edge between two cells than this share of half a cell.
    contrast = float(np.quantile(least / (2 * amplitude), NEARLY_ALL))
    blur_px = _BLURS_CELLS * axis.cell
    times = np.exp(2 * (np.pi * blur_px / axis.fringes[0].period) ** 2)
    of_stripes = scipy.special.erf(NEARLY_ALL * axis.cell / 2 / (np.sqrt(2) * blur_px))
    weaker = float(np.interp(contrast, of_stripes * times, times, left=1.0))
    return weaker if weaker > _IN_FOCUS else 1.0
