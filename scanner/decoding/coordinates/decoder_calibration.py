"""Calibrate the decoders of both axes on a sample of the capture: tolerances, blur, response."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from calib.numerics import Bools, Floats32, evenly_spread, median
from scanner.decoding.coordinates.axis_decoder import AxisDecoder, UnwrappedFringes, largest_variance
from scanner.decoding.coordinates.code_images import Signals
from scanner.decoding.coordinates.resolution import weakened
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
from scanner.decoding.light import NoiseModel
from scanner.decoding.sequence_plan import ENOUGH_CYCLES, AxisPlan, Fringe, SequencePlan
from scanner.decoding.significance import ENDS, NEARLY_ALL, NEGLIGIBLE


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
    raw = [
        AxisDecoder(axis, noise, saturation, (None,) * len(axis.fringes), widest_tolerances(axis)) for axis in plan.axes
    ]
    plain, phases = zip(*map(_with_tolerances, raw, signals), strict=True)
    chosen, ripples = [*plain], _ripples(chain(*phases))
    if ripples:
        rippled = [replace(decoder, ripple=tuple(map(ripples.get, decoder.plan.fringes))) for decoder in raw]
        straightened = [decoder for decoder, _ in map(_with_tolerances, rippled, signals)]
        # Periods are rippled at different places, so that a right correction reduces their disagreement.
        worse = any(
            sum(new.tolerances.fringe_px) > sum(old.tolerances.fringe_px)
            for new, old in zip(straightened, plain, strict=True)
        )
        chosen = chosen if worse else straightened
    x, y = _with_response(chosen, signals, levels)
    return x, y


def agreeing(measured: UnwrappedFringes) -> Bools:
    """(P,): the well lit pixels of a sample whose codes and fringes are consistent."""
    return measured.orders.agree & measured.interval.possible & measured.well_lit


def measured_widely(
    decoders: tuple[AxisDecoder, AxisDecoder], signals: tuple[Signals, Signals]
) -> list[tuple[AxisDecoder, UnwrappedFringes]]:
    """Return the decoders of axes with fringes, each with what it measures with the widest tolerances."""
    return [
        (decoder, replace(decoder, tolerances=widest_tolerances(decoder.plan)).measure(part))
        for decoder, part in zip(decoders, signals, strict=True)
        if decoder.plan.fringes
    ]


def modulation(measured: Iterable[UnwrappedFringes]) -> float | None:
    """Return the median amplitude of the shortest fringes relative to the level half-way between lit and unlit.

    1 for a sharp image of a projector without black level in a dark room; None without fringes.
    """
    shares = [np.sqrt(axis.power(-1)[axis.well_lit]) / np.maximum(axis.level[axis.well_lit], 1) for axis in measured]
    return median(np.concatenate(shares)) if sum(map(len, shares)) else None


def _with_tolerances(decoder: AxisDecoder, signals: Signals) -> tuple[AxisDecoder, Iterable[_Phases]]:
    """Return the decoder with the tolerances that it finds, and the phases that it sees."""
    if not decoder.plan.fringes:
        return decoder, ()
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


def _with_response(
    decoders: list[AxisDecoder], signals: tuple[Signals, Signals], levels: Floats32
) -> list[AxisDecoder]:
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

    def knowing(decoder: AxisDecoder) -> AxisDecoder:
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


def _phases(decoder: AxisDecoder, signals: Signals, measured: UnwrappedFringes) -> Iterator[_Phases]:
    # Judged by the fringes themselves, saturation would depend on the phase.
    lit = measured.well_lit & (signals.white < decoder.saturation)
    agrees = agreeing(measured)
    for fringe, coordinate in zip(decoder.plan.fringes, measured.orders.coordinates, strict=True):
        if can_ripple(fringe) and agrees.any():
            first, last = np.quantile(evenly_spread(coordinate[agrees]), ENDS)
            phases = np.float32(2 * np.pi / fringe.period) * coordinate[lit]
            yield _Phases(fringe, phases, float(last - first) / fringe.period)
