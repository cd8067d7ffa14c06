"""Calibrate the decoders of both axes on a sample of the capture: what the lenses resolve, tolerances, blur, response.

A bit is weak where its contrast is a small share of the coarse bits' contrast at the same pixel. It then follows
sharpening, crosstalk and stray light rather than the pattern. Weak bits are dropped if that decides more pixels than
their finer cells are worth, or if it makes neighbouring cells adjacent. Where camera pixels are larger than cells, so
that most of them lack some bit, each pixel uses the bits that it has.

Interreflection weakens fringes and stripes alike, relative to white. Lens blur weakens fringes more than the middle of
a stripe, which separates the two.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Bools, Floats32, Image, Ints, evenly_spread, lines_of, median
from scanner.decoding.codes import CodeWords, cell_numbers, check_codes
from scanner.decoding.coordinates.axis_decoder import (
    AxisDecoder,
    FringeAxis,
    GrayAxis,
    UnwrappedFringes,
    largest_variance,
    least_contrasts,
)
from scanner.decoding.coordinates.code_images import CodeImages, Signals, signals_of
from scanner.decoding.fringes import (
    FringeSample,
    Unchecked,
    can_ripple,
    disagreements,
    measured_tolerances,
    response_of,
    straightening,
    widest_tolerances,
)
from scanner.decoding.light import STRAY_PART, NoiseModel, Sample
from scanner.decoding.sequence_plan import ENOUGH_CYCLES, AxisPlan, Fringe, SequencePlan
from scanner.decoding.significance import BRIGHTEST, ENDS, FARTHEST_PX, FEW, FEWEST_PIXELS, HALF, NEARLY_ALL, NEGLIGIBLE
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


def resolve_bits(code_images: CodeImages, noise: NoiseModel, pixels: Ints) -> tuple[CodeImages, list[Finding]]:
    """Return the images without the bits that are not resolved at sample pixels (P,), and a warning for each code."""
    chosen: list[CodeWords] = []
    findings = []
    for code_words in code_images.codes:
        resolved, count = _resolved(code_images, code_words, noise, pixels) if code_words.fine else (code_words, 0)
        chosen.append(resolved)
        if count:
            code = code_words.code
            bits, cell = range(code.bits - count, code.bits), chosen[-1].code.cell
            message = (
                f"Bit {', '.join(map(str, bits))} of the Gray code along {code.axis} is too fine for the lenses and "
                f"was left out: cells of {cell} px are decoded."
            )
            values: dict[str, float | tuple[int, ...]] = {"bits": tuple(bits), "cell_px": float(cell)}
            findings.append(Finding(UNRESOLVED_BITS, Severity.WARNING, message, UNRESOLVED_BITS.remedy, values))
    return code_images.decoded_as(chosen), findings


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


def drop_lost_fringes(code_images: CodeImages, noise: NoiseModel, sample: Sample) -> tuple[CodeImages, Finding | None]:
    """Return the images without fringes, and a warning, if blur leaves hardly any on an axis with a code, judged by a
    sample; otherwise as they are.
    """
    pixels = evenly_spread(sample.pixels)
    signals = signals_of(
        code_images, lambda image: image.reshape(1, -1)[:, pixels], lambda frame: evenly_spread(sample.level(frame))
    )
    lost = [
        axis
        for axis, of_axis in zip(code_images.plan.axes, signals, strict=True)
        if axis.codes and axis.fringes and _is_lost(axis, of_axis, code_images, noise, sample)
    ]
    if not lost or not all(axis.codes for axis in code_images.plan.axes):
        return code_images, None
    cell = max(axis.cell for axis in lost)
    message = (
        f"The fringes along {' and '.join(axis.axis for axis in lost)} are blurred away and were left out: cells "
        f"of the Gray code of {cell:g} px are decoded."
    )
    values = {"cell_px": float(cell)}
    return code_images.without_fringes(), Finding(
        BLURRED_FRINGES, Severity.WARNING, message, BLURRED_FRINGES.remedy, values
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


@dataclass(frozen=True)
class _Phases:
    """Raw phases (P,) of a fringe in radians, with any whole cycles, and over how many cycles the pixels are spread."""

    fringe: Fringe
    phases: Floats32
    cycles: float


def calibrated_decoders(
    plan: SequencePlan, noise: NoiseModel, saturation: float, signals: tuple[Signals, Signals], levels: Floats32
) -> tuple[AxisDecoder, AxisDecoder]:
    """Return decoders for x and y from a sample of the signals of each, and of `levels` (frames, P)
    at the same pixels.
    """
    with_fringes = [axis for axis in plan.axes if axis.fringes]
    parts = [part for axis, part in zip(plan.axes, signals, strict=True) if axis.fringes]
    raw = [
        FringeAxis(axis, noise, saturation, (None,) * len(axis.fringes), widest_tolerances(axis))
        for axis in with_fringes
    ]
    with_phases = [*map(_with_tolerances, raw, parts)]
    plain = chosen = [decoder for decoder, _ in with_phases]
    if ripples := _ripples(chain(*(phases for _, phases in with_phases))):
        rippled = [replace(decoder, ripple=tuple(map(ripples.get, decoder.plan.fringes))) for decoder in raw]
        straightened = [decoder for decoder, _ in map(_with_tolerances, rippled, parts)]
        # Periods are rippled at different places, so that a right correction reduces their disagreement.
        worse = any(
            sum(new.tolerances.fringe_px) > sum(old.tolerances.fringe_px)
            for new, old in zip(straightened, plain, strict=True)
        )
        chosen = chosen if worse else straightened
    calibrated = iter(_with_response(chosen, parts, levels))
    x, y = (next(calibrated) if axis.fringes else GrayAxis(axis, noise) for axis in plan.axes)
    return x, y


def agreeing(measured: UnwrappedFringes) -> Bools:
    """(P,): the well lit pixels of a sample whose codes and fringes are consistent."""
    return measured.orders.agree & measured.interval.possible & measured.well_lit


def measured_widely(
    decoders: tuple[AxisDecoder, AxisDecoder], signals: tuple[Signals, Signals]
) -> list[tuple[FringeAxis, UnwrappedFringes]]:
    """Return the decoders of axes with fringes, each with what it measures with the widest tolerances."""
    return [
        (decoder, replace(decoder, tolerances=widest_tolerances(decoder.plan)).measure(part))
        for decoder, part in zip(decoders, signals, strict=True)
        if isinstance(decoder, FringeAxis)
    ]


def modulation(measured: Iterable[UnwrappedFringes]) -> float | None:
    """Return the median amplitude of the shortest fringes relative to the level half-way between lit and unlit.

    1 for a sharp image of a projector without black level in a dark room; None without fringes.
    """
    shares = [np.sqrt(axis.power(-1)[axis.well_lit]) / np.maximum(axis.level[axis.well_lit], 1) for axis in measured]
    return median(np.concatenate(shares)) if sum(map(len, shares)) else None


def _with_tolerances(decoder: FringeAxis, signals: Signals) -> tuple[FringeAxis, Iterable[_Phases]]:
    """Return the decoder with the tolerances that it finds, and the phases that it sees."""
    measured = decoder.measure(signals)
    chosen = agreeing(measured)
    variances = np.compress(chosen, measured.variances, axis=1)
    distances = disagreements(measured.orders, measured.interval, chosen)
    tolerances = measured_tolerances(decoder.plan, distances, variances)
    lit, finest = measured.well_lit, _finest_seen(decoder.plan, variances)
    least = signals.least[:, lit].min(axis=0) if len(signals.least) else np.empty(0, np.float32)
    blurred = weakened(decoder.plan, least, np.sqrt(measured.power(0)[lit]))
    phases = _phases(decoder, signals, measured)
    return replace(decoder, tolerances=tolerances, finest=finest, blurred=blurred), phases


def _with_response(decoders: list[FringeAxis], signals: list[Signals], levels: Floats32) -> list[FringeAxis]:
    """Return the decoders with the response that amplitudes determine, for axes whose phase nothing else checks."""
    alone = [(decoder, part) for decoder, part in zip(decoders, signals, strict=True) if decoder.plan.is_unchecked]
    if not alone:
        return decoders
    lit: Bools = np.logical_and.reduce([d.measure(part).well_lit & (part.white < d.saturation) for d, part in alone])
    fringe_samples = []
    for decoder, part in alone:
        (fringe,) = decoder.plan.fringes
        cosine, sine = (component.astype(np.float64)[lit] for component in part.fringe(0))
        mean = levels[list(fringe.frames)].mean(axis=0, dtype=np.float64)
        amplitude, level = (np.log(np.maximum(values, NEGLIGIBLE)) for values in (np.hypot(cosine, sine), mean[lit]))
        fringe_samples.append(FringeSample(fringe, np.arctan2(sine, cosine), amplitude, level))
    response = response_of(fringe_samples)

    def knowing(decoder: FringeAxis) -> FringeAxis:
        ripple = response.straightening(decoder.plan.fringes[0])
        return replace(decoder, ripple=(ripple,), unchecked=Unchecked(decoder.plan, response))

    return [knowing(decoder) if decoder.plan.is_unchecked else decoder for decoder in decoders]


def _finest_seen(plan: AxisPlan, variances: Floats32) -> int:
    """Return the index of the shortest fringe that is resolved at nearly all sample pixels."""
    finest = 0
    for number, (fringe, variance) in enumerate(zip(plan.fringes, variances, strict=True)):
        if variance.size and np.mean(variance <= np.float32(largest_variance(fringe))) >= NEARLY_ALL:
            finest = number
    return finest


def _ripples(samples: Iterable[_Phases]) -> dict[Fringe, Floats32]:
    """Return the phase correction of each fringe.

    Fringes of equal shifts and period share it on both axes and are measured together. If the pixels see too few cycles
    of a period, or too unevenly, the correction of the next shorter period is used.
    """
    groups: dict[tuple[int, float], list[_Phases]] = defaultdict(list)
    for phases in samples:
        steps = len(phases.fringe.shifts)
        groups[steps, round(phases.fringe.shifts[0] * steps % 1, 6) % 1].append(phases)
    tables = {}
    for group in groups.values():
        table = None
        for period in sorted({phases.fringe.period for phases in group}):
            same_period = [phases for phases in group if phases.fringe.period == period]
            if sum(sample.cycles for sample in same_period) >= ENOUGH_CYCLES:
                own = straightening(same_period[0].fringe, [sample.phases for sample in same_period])
                table = table if own is None else own
            if table is not None:
                tables.update({sample.fringe: table for sample in same_period})
    return tables


def _phases(decoder: FringeAxis, signals: Signals, measured: UnwrappedFringes) -> Iterator[_Phases]:
    # Judged by the fringes themselves, saturation would depend on the phase.
    lit = measured.well_lit & (signals.white < decoder.saturation)
    agrees = agreeing(measured)
    for fringe, coordinate in zip(decoder.plan.fringes, measured.orders.coordinates, strict=True):
        if can_ripple(fringe) and agrees.any():
            first, last = np.quantile(evenly_spread(coordinate[agrees]), ENDS)
            phases = np.float32(2 * np.pi / fringe.period) * coordinate[lit]
            yield _Phases(fringe, phases, float(last - first) / fringe.period)
