"""The decoders of both axes, with everything that a sample of the capture tells about its fringes."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from math import sqrt
from typing import cast

import cv2
import numpy as np

from scanner.decoding.arrays import Floats32
from scanner.decoding.codes import interval_of
from scanner.decoding.coordinate import AxisDecoder, Signals
from scanner.decoding.noise import NoiseModel
from scanner.decoding.plan import AxisPlan, Fringe, SequencePlan
from scanner.decoding.response import can_ripple, straightening
from scanner.decoding.unwrap import GAUSSIAN_MEDIAN, Orders, measured_tolerances, widest_tolerances


def calibrated_decoders(
    plan: SequencePlan, noise: NoiseModel, saturation: float, signals: tuple[Signals, Signals]
) -> tuple[AxisDecoder, AxisDecoder]:
    """Decoders for x and y from a sample of the signals of each."""
    raw = [
        AxisDecoder(axis, noise, saturation, (None,) * len(axis.fringes), widest_tolerances(axis)) for axis in plan.axes
    ]
    plain = [_with_tolerances(decoder, part) for decoder, part in zip(raw, signals, strict=True)]
    ripples = _ripples(raw, signals)
    straightened = [
        _with_tolerances(replace(decoder, ripple=tuple(ripples.get(fringe) for fringe in decoder.plan.fringes)), part)
        for decoder, part in zip(raw, signals, strict=True)
    ]
    # Two periods are rippled at different places, so that a right correction brings them together.
    worse = any(
        sum(new.tolerances.fringe_px) > sum(old.tolerances.fringe_px)
        for new, old in zip(straightened, plain, strict=True)
    )
    x, y = plain if worse else straightened
    return x, y


def sample_orders(decoder: AxisDecoder, signals: Signals) -> tuple[Orders, list[Floats32]]:
    """The fringe orders and variances of the well lit pixels of a sample, as far as they make sense at all."""
    interval = interval_of(decoder.plan, signals.words)
    variances = decoder.fringe_variances(signals)
    orders = decoder.orders(signals, interval, variances)
    good = orders.agree & ~interval.outside & ~interval.contradictory & decoder.well_lit(signals)
    return orders[good], [variance[good] for variance in variances]


def modulation(decoders: tuple[AxisDecoder, AxisDecoder], signals: tuple[Signals, Signals]) -> float | None:
    """The median amplitude of the shortest fringes relative to the level half-way between lit and unlit.

    1 for a sharp image of a projector without black level in a dark room; None without fringes.
    """
    shares = []
    for decoder, part in zip(decoders, signals, strict=True):
        if part.fringes:
            lit = decoder.well_lit(part)
            shares.append(cv2.magnitude(*part.fringes[-1])[lit] / np.maximum(part.middle[lit], 1))
    return float(np.median(np.concatenate(shares))) if sum(map(len, shares)) else None


def _with_tolerances(decoder: AxisDecoder, signals: Signals) -> AxisDecoder:
    if not decoder.plan.fringes:
        return decoder
    orders, variances = sample_orders(decoder, signals)
    return replace(
        decoder,
        tolerances=measured_tolerances(decoder.plan, orders, variances),
        systematic=_systematic(decoder.plan, orders, variances),
    )


def _ripples(decoders: list[AxisDecoder], signals: tuple[Signals, Signals]) -> dict[Fringe, Floats32]:
    """Per fringe, what straightens its phase; fringes with the same shifts are bent alike and measured together."""
    groups: dict[tuple[int, float], list[tuple[Fringe, Floats32]]] = defaultdict(list)
    for decoder, part in zip(decoders, signals, strict=True):
        for fringe, components in zip(decoder.plan.fringes, part.fringes, strict=True):
            if can_ripple(fringe):
                steps = len(fringe.shifts)
                phases = cast(Floats32, cv2.phase(*components))[decoder.well_lit(part)]
                groups[steps, round(fringe.shifts[0] * steps % 1, 6) % 1].append((fringe, phases))
    found = {}
    for group in groups.values():
        table = straightening(group[0][0], [phases for _, phases in group])
        found.update({fringe: table for fringe, _ in group if table is not None})
    return found


def _systematic(plan: AxisPlan, orders: Orders, variances: list[Floats32]) -> float:
    """How much more two periods disagree than noise makes them, in cycles, where few shifts let harmonics through."""
    found = []
    for fringes, noises, distance in zip(pairwise(plan.fringes), pairwise(variances), orders.distances(), strict=True):
        if len(distance) and all(can_ripple(fringe) for fringe in fringes):
            total = float(np.median(distance)) / GAUSSIAN_MEDIAN
            excess = total**2 - float(np.median(noises[0] + noises[1]))
            found.append(max(0.0, excess) / sum(fringe.period**2 for fringe in fringes))
    return sqrt(np.mean(found)) if found else 0.0
