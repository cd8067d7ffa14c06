"""What a network fits better with: pictures through a homography, or a device that was moved between its captures.

A device shows or records through a homography by keystone correction, digital zoom, or a resampled image.

With one device's picture warped and all others as they are, the captures are likelier by a factor that tells which
device it is. Noise is measured with all of them free, since what a warp does would else pass for noise.

A keystone of 1 % may raise χ² by less than chance does, and yet move focal lengths by several sigmas. So each single
parameter is weighed by its evidence: what is certain is named, and all that is possible is in the covariance.

A device that was moved between its captures, weighed against other explanations of what does not fit together.

A device that stood elsewhere for one capture is a device more, with the same lens. Planes that captures do not share
after all, or pictures that are warped, may fit as well, with more parameters: so explanations are compared by the
Bayesian information criterion (Schwarz 1978, Annals of Statistics 6, 461), of the noise that each leaves, with as many
observations as there are independent ones among the cells.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.estimation import Fit, Term, long_waves
from calib.geometry import PER_PLANE, PER_POSE
from calib.networks.diagnostics import strains
from calib.networks.initialisation import ROUGH, Grown
from calib.networks.network import PER_WARP, WARP, Network
from calib.networks.observations import NetworkProblem, PlaneObservation
from calib.networks.prior import WARP_SIGMA
from calib.networks.weights import Weights
from calib.numerics import CUBIC, Bools, Floats
from calib.refinement import PER_DEVICE, alternative, averaged

_SAME = np.array([1e-5, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])  # of log f, x_0, y_0, k1, k2, p1, p2, k3
_FAR_LIKELIER = 10.0  # of the criterion: odds of 150 to 1
_USUAL = 1.0, 99.0  # percentiles of residuals; beyond are outliers
_CHANCE = 1e-4
_AS_LIKELY = 10.0  # of χ²: odds of 150 to 1
_CERTAIN = 20.0  # odds
_STRAINED = 3.0  # times the noise, across the lines on which walls that are not flat move cells
# Beforehand, of a picture's aspect, as in `calib.refinement.alternatives`, its skew, and its trapezoids: projectors,
# even by themselves, make upright ones. No camera does.
_PROBABILITIES = {True: (0.01, 0.01, 0.01, 0.01), False: (0.01, 0.01, 0.1, 0.3)}  # by whether it is a camera's
_ROUNDS = 2
_FOR_NOISE, _ENOUGH = 1e-3, 1.0  # tolerance of fits, the former of their cost


@dataclass(frozen=True)
class SameLens:
    """Two devices, by number, that are one in two places."""

    first: int
    second: int

    def misfit(self, network: Network) -> Term:
        """Of the difference of both lenses."""
        first, second = (network.devices[device].lens for device in (self.first, self.second))
        off = np.array([np.log(second[0] / first[0]), *(second - first)[1:]]) / _SAME
        columns = [np.r_[network.device_columns(device)][:PER_DEVICE] for device in (self.first, self.second)]
        return Term.gaussian(np.concatenate(columns), off, np.hstack([-np.diag(1 / _SAME), np.diag(1 / _SAME)]))


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why captures do not fit together: `fit` of the `sights` under the scatter of matches, with so many `parameters`
    more than if nothing were wrong. `moved`: the device that was moved, if that is it.
    """

    fit: Fit[Network]
    sights: Sequence[PlaneObservation]
    parameters: int
    moved: str = ""


def moves(grown: Grown, sights: Sequence[PlaneObservation], network: Network) -> Iterator[Explanation]:
    """Each device that has several captures, moved for one of them; fitted from near a network without a move."""
    for capture, pair in enumerate(grown.labelled):
        planes = sum(sight.capture == capture for sight in sights)
        for role, name in enumerate(pair):
            number, elsewhere = grown.names.index(name), len(grown.names)
            if not planes or {s.capture for s in sights if number in (s.camera, s.projector)} == {capture}:
                continue
            split = [_with_device(s, role, elsewhere) if s.capture == capture else s for s in sights]
            doubled = replace(network, devices=(*network.devices, network.devices[number]))
            more = replace(grown, names=(*grown.names, name))
            problem = replace(more.problem(doubled, split), joints=(SameLens(number, elsewhere),))
            fit = problem.minimise(doubled, tolerance=ROUGH)
            # A plane tells no more of where a device is than three numbers, its own.
            yield Explanation(fit, split, min(PER_POSE, PER_PLANE * planes), name)


def _with_device(sight: PlaneObservation, role: int, number: int) -> PlaneObservation:
    return replace(sight, projector=number) if role else replace(sight, camera=number)


def likeliest(usual: Explanation, alternatives: Sequence[Explanation]) -> Explanation:
    """The one of the least criterion; `usual`, unless another one is likelier by far."""
    count = _independent(min([usual, *alternatives], key=lambda explanation: explanation.fit.cost))

    def criterion(explanation: Explanation) -> float:
        return count * math.log(explanation.fit.cost) + explanation.parameters * math.log(count)

    best = min(alternatives, key=criterion, default=usual)
    return best if criterion(best) < criterion(usual) - _FAR_LIKELIER else usual


def _independent(explanation: Explanation) -> float:
    """Number of independent coordinates among those of all cells: errors of neighbours are alike where waves of walls,
    or lenses, make them, which polynomials over a sight tell.
    """
    count = 0.0
    for sight, residual in zip(explanation.sights, explanation.fit.residuals, strict=True):
        off = np.clip(residual, *np.percentile(residual, _USUAL, axis=0))
        square = np.mean((off / sight.cells.sigma_px[:, None]) ** 2)
        smooth = long_waves(sight.cells, off, square * sight.cells.sigma_px**2)[0][0] / (2 * CUBIC)
        count += 2 * len(off) / max(smooth, 1.0) if np.isfinite(smooth) else PER_PLANE
    return max(count, 2.0)


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


def weighed(
    problem: NetworkProblem, fit: Fit[Network], names: Sequence[str], cameras: Collection[str]
) -> tuple[Warps, Floats]:
    """Warps of one parameter of one picture, by their evidence: those that are certain; and the covariance (size, size)
    with all of them that the captures do not exclude.
    """
    alternatives = []
    for number, name in enumerate(names):
        start, probabilities = fit.state.device_columns(number).start + WARP.start, _PROBABILITIES[name in cameras]
        for k, (probability, spread) in enumerate(zip(probabilities, WARP_SIGMA.tolist(), strict=True)):
            alternatives.append(
                (name, k, alternative(fit.information, fit.gradient, problem.free, start + k, probability, spread))
            )
    alternatives.sort(key=lambda alternative: -alternative[2].odds)
    total = 1 + sum(alternative.odds for _, _, alternative in alternatives)
    covariance = averaged(problem.covariance(fit), [alternative for _, _, alternative in alternatives])
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
