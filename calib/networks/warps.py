"""What a network fits better with: pictures through a homography, or a device that was moved between its captures.

A device shows or records through a homography by keystone correction, digital zoom, or a resampled image.

With one device's picture warped and all others as they are, the captures are likelier by a factor that tells which
device it is. Noise is measured with all of them free, since what a warp does would else pass for noise.

A keystone of 1 % may raise χ² by less than chance does, and yet move focal lengths by several sigmas. So each single
parameter is weighed by its evidence: what is certain is named, and all that is possible is in the covariance.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.estimation import Fit
from calib.networks.diagnostics import strains
from calib.networks.initialisation import ROUGH, Grown
from calib.networks.moves import Explanation, likeliest, moves
from calib.networks.network import PER_WARP, WARP, Network
from calib.networks.observations import NetworkProblem, PlaneObservation
from calib.networks.prior import WARP_SIGMA
from calib.networks.weights import Weights
from calib.numerics import Bools, Floats
from calib.refinement import alternative

_CHANCE = 1e-4
_AS_LIKELY = 10.0  # of χ²: odds of 150 to 1
_CERTAIN = 20.0  # odds
_STRAINED = 3.0  # times the noise, across the lines on which walls that are not flat move cells
# Beforehand, of a picture's aspect, as in `calib.refinement.alternatives`, its skew, and its trapezoids: projectors,
# even by themselves, make upright ones.
_PROBABILITY = 0.01, 0.01, 0.1, 0.3
_ROUNDS = 2
_FOR_NOISE, _ENOUGH = 1e-3, 1.0  # tolerance of fits, the former of their cost


@dataclass(frozen=True, eq=False)
class Warp:
    """`gain`: χ², of four degrees of freedom by chance, if the picture of device `name` alone is warped, by `warp` (4,)
    as of `Device`.
    """

    name: str
    gain: float
    warp: Floats

    @property
    def trapezoid(self) -> float:
        """By how much one of its edges is longer than the opposite one."""
        return float(np.abs(self.warp[2:]).max())


@dataclass(frozen=True)
class Warps:
    """Devices of which each `alone` may be the warped one, likeliest first; `several`: no one explains it. `moved`: the
    device that does, if it was moved between its captures.
    """

    alone: tuple[Warp, ...] = ()
    several: bool = False
    moved: str = ""

    def __bool__(self) -> bool:
        """Whether anything is warped, or was moved."""
        return bool(self.alone or self.several or self.moved)


def _by_chance(freedom: int) -> float:
    """What so many degrees of freedom gain in χ² by chance."""
    return float(scipy.special.chdtri(freedom, _CHANCE))


def find_warps(
    grown: Grown, sights: Sequence[PlaneObservation], fit: Fit[Network]
) -> tuple[Warps, Fit[Network], Weights]:
    """From a fit under the scatter of matches; also one without a warp, and the weights that it was made with."""
    free, devices = grown.free(fit.state), range(len(grown.names))
    weights = Weights(grown.problem(fit.state, sights), rough=True).freeing(_freed(fit.state, free, devices))
    whole = weights.fitted(fit.state, _FOR_NOISE * fit.cost)
    for _ in range(_ROUNDS):
        _, weights = weights.measured_anew(grown, whole)
        whole = weights.fitted(whole.state, _ENOUGH)
    usual = weights.freeing(free)
    none = usual.fitted(_without_warps(whole.state), _ENOUGH)
    if none.cost - whole.cost < _by_chance(PER_WARP) or is_strained(sights, whole):
        return Warps(), none, usual
    whole = weights.fitted(whole.state, ROUGH)
    # From walls that waves bent to fit a warp, a descent may end before it is down.
    starts = none.state, fit.state
    none = min((usual.fitted(start, ROUGH) for start in starts), key=lambda start: start.cost)
    if none.cost - whole.cost < _by_chance(PER_WARP):
        return Warps(), none, usual
    candidates = []
    for number, name in enumerate(grown.names):
        start, columns = _without_warps(whole.state, but=number), _freed(fit.state, free, (number,))
        alone = weights.freeing(columns).fitted(start, ROUGH)
        candidates.append(Warp(name, none.cost - alone.cost, alone.state.devices[number].warp))
    candidates.sort(key=lambda candidate: -candidate.gain)
    several = none.cost - whole.cost - candidates[0].gain > _by_chance(PER_WARP * (len(devices) - 1))
    if several or candidates[0].gain < _by_chance(PER_WARP):
        return Warps(several=several), none, usual
    likely = tuple(candidate for candidate in candidates if candidate.gain > candidates[0].gain - _AS_LIKELY)
    return Warps(likely), none, usual


def weighed(problem: NetworkProblem, fit: Fit[Network], names: Sequence[str]) -> tuple[Warps, Floats]:
    """Warps of one parameter of one picture, by their evidence: those that are certain, and what all of them that the
    captures do not exclude add to the covariance (size, size).
    """
    alternatives = []
    for number, name in enumerate(names):
        start = fit.state.device_columns(number).start + WARP.start
        for k, (probability, spread) in enumerate(zip(_PROBABILITY, WARP_SIGMA.tolist(), strict=True)):
            alternatives.append(
                (name, k, alternative(fit.information, fit.gradient, problem.free, start + k, probability, spread))
            )
    alternatives.sort(key=lambda alternative: -alternative[2].odds)
    total = 1 + sum(alternative.odds for _, _, alternative in alternatives)
    covariance = sum(
        (alternative.added(alternative.odds / total) for _, _, alternative in alternatives),
        np.zeros_like(fit.information),
    )
    if total < _CERTAIN or is_strained(problem.parts, fit):
        return Warps(), covariance
    likely: dict[str, Warp] = {}
    for name, k, moved in alternatives:
        if moved.odds * np.exp(_AS_LIKELY / 2) > alternatives[0][2].odds:
            warp = moved.value * np.eye(PER_WARP)[k]
            likely.setdefault(name, Warp(name, (moved.value / moved.sigma) ** 2, warp))
    return Warps(tuple(likely.values())), covariance


def warped(
    grown: Grown, sights: Sequence[PlaneObservation], fit: Fit[Network], names: Collection[str] | None = None
) -> Explanation:
    """The pictures of these devices, or of all, are warped."""
    devices = [number for number, name in enumerate(grown.names) if names is None or name in names]
    start, free = _without_warps(fit.state), _freed(fit.state, grown.free(fit.state), devices)
    problem = replace(grown.problem(start, sights), free=free)
    return Explanation(problem.minimise(start, tolerance=ROUGH), sights, PER_WARP * len(devices))


def or_moved(warps: Warps, grown: Grown, sights: Sequence[PlaneObservation], fit: Fit[Network]) -> Warps:
    """In place of warps that were found, a device that was moved between its captures, if that is likelier."""
    if not warps:
        return warps
    alone = [warped(grown, sights, fit, [warp.name]) for warp in warps.alone]
    usual = likeliest(warped(grown, sights, fit), alone)
    moved = likeliest(usual, list(moves(grown, sights, fit.state))).moved
    return Warps(moved=moved) if moved else warps


def is_strained(sights: Sequence[PlaneObservation], fit: Fit[Network]) -> bool:
    """Whether cells of a pair are far off the lines on which walls that are not flat move them."""
    return any(strain.across_px > _STRAINED * strain.noise_px for strain in strains(sights, fit).values())


def _freed(network: Network, free: Bools, devices: Collection[int]) -> Bools:
    """With the warps of some devices."""
    columns = free.copy()
    for number in devices:
        columns[network.device_columns(number)][WARP] = True
    return columns


def _without_warps(network: Network, but: int | None = None) -> Network:
    devices = (
        device if number == but else replace(device, warp=np.zeros(PER_WARP))
        for number, device in enumerate(network.devices)
    )
    return replace(network, devices=tuple(devices))
