"""Pictures that a device shows, or records, through a homography: keystone correction, digital zoom, a resampled image.

With one device's picture warped and all others as they are, the captures are likelier by a factor that tells which
device it is. Noise is measured with all of them free, since what a warp does would else pass for noise.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from calib.networks.doubts import strains
from calib.networks.growth import ROUGH, Grown
from calib.networks.network import PER_WARP, WARP, Network
from calib.networks.prior import WARP_SIGMA
from calib.networks.sights import Sight
from calib.networks.weights import Weights
from calib.numerics import Bools, Floats
from calib.refinement import alternative
from calib.rooms.likelihood import Fit

_CHANCE = 1e-4
_BY_CHANCE = float(chdtri(PER_WARP, _CHANCE))
_AS_LIKELY = 10.0  # of χ²: odds of 150 to 1
_STRAINED = 3.0  # times the noise, across the lines on which walls that are not flat move cells
_PROBABILITY = 0.01  # of each picture, as of one that is scaled in `calib.refinement.picture_scale`
_ROUNDS = 2
_FOR_NOISE, _ENOUGH = 1e-3, 1.0  # tolerance of fits, the former of their cost


@dataclass(frozen=True, eq=False)
class Warp:
    """`gain`: χ², of four degrees of freedom by chance, if the picture of device `name` alone is warped, by `warp` (4,)
    as of `Device`. `trapezoid`: by how much one of its edges is then longer than the opposite one.
    """

    name: str
    gain: float
    warp: Floats
    trapezoid: float


@dataclass(frozen=True)
class Warps:
    """Devices of which each `alone` may be the warped one, likeliest first; `several`: no one explains it."""

    alone: tuple[Warp, ...] = ()
    several: bool = False


def find_warps(grown: Grown, sights: Sequence[Sight], fit: Fit[Network]) -> tuple[Warps, Fit[Network], Weights]:
    """From a fit under the scatter of matches; also one without a warp, and the weights that it was made with."""
    free, devices = grown.free(fit.layout), range(len(grown.names))
    every, weights = _freed(fit.layout, free, devices), Weights.of_noise(sights)
    whole = weights.fitted(grown, sights, fit.layout, every, _FOR_NOISE * fit.cost)
    for _ in range(_ROUNDS):
        _, weights = weights.measured_anew(grown, sights, whole, every)
        whole = weights.fitted(grown, sights, whole.layout, every, _ENOUGH)
    none = weights.fitted(grown, sights, _without_warps(whole.layout), free, _ENOUGH)
    strained = any(each.across_px > _STRAINED * each.noise_px for each in strains(sights, whole).values())
    if none.cost - whole.cost < _BY_CHANCE or strained:
        return Warps(), none, weights
    whole = weights.fitted(grown, sights, whole.layout, every, ROUGH)
    # From walls that waves bent to fit a warp, a descent may end before it is down.
    starts = none.layout, fit.layout
    none = min((weights.fitted(grown, sights, each, free, ROUGH) for each in starts), key=lambda each: each.cost)
    if none.cost - whole.cost < _BY_CHANCE:
        return Warps(), none, weights
    found = []
    for number, name in enumerate(grown.names):
        start, columns = _without_warps(whole.layout, but=number), _freed(fit.layout, free, (number,))
        alone = weights.fitted(grown, sights, start, columns, ROUGH)
        device = alone.layout.devices[number]
        trapezoid = float(np.max(np.abs(device.warp[2:]) * grown.knowledge.sizes[name])) / float(device.lens[0])
        found.append(Warp(name, none.cost - alone.cost, device.warp, trapezoid))
    found.sort(key=lambda each: -each.gain)
    several = none.cost - whole.cost - found[0].gain > float(chdtri(PER_WARP * (len(devices) - 1), _CHANCE))
    if several or found[0].gain < _BY_CHANCE:
        return Warps(several=several), none, weights
    likely = tuple(each for each in found if each.gain > found[0].gain - _AS_LIKELY)
    return Warps(likely), none, weights


def covariance_of_warps(fit: Fit[Network], free: Bools) -> Floats:
    """What warps that the captures do not exclude add to the covariance (size, size), one parameter of one picture at
    most.
    """
    covariance, total, others = np.zeros_like(fit.information), 1.0, []
    for number in range(len(fit.layout.devices)):
        columns = np.arange(fit.layout.size)[fit.layout.device_columns(number)][WARP]
        for column, spread in zip(columns.tolist(), WARP_SIGMA.tolist(), strict=True):
            others.append(alternative(fit.information, fit.gradient, free, column, _PROBABILITY, spread))
            total += others[-1].odds
    for other in others:
        covariance += other.added(other.odds / total)
    return covariance


def _freed(network: Network, free: Bools, devices: Collection[int]) -> Bools:
    """With the warps of some devices."""
    columns = free.copy()
    for number in devices:
        columns[network.device_columns(number)][WARP] = True
    return columns


def _without_warps(network: Network, but: int | None = None) -> Network:
    devices = (
        each if number == but else replace(each, warp=np.zeros(PER_WARP)) for number, each in enumerate(network.devices)
    )
    return replace(network, devices=tuple(devices))
