"""A network from stations of anything rigid, before which its pairs of camera and projector are calibrated one by one.

No plane is needed. Pairs that are calibrated by themselves have units of length of their own. Pixels that two pairs
share, of a camera that sees two projectors or of a projector that two cameras see, tie them: under both, a point is at
one depth. A device without a calibrated pair follows by the points that others tell of such pixels.

What is known of a camera and a projector that are calibrated by themselves, as a factor of a network.

A calibration with its covariance stands for all that it was made from (submaps; Ni, Steedly and Dellaert, "Tectonic
SAM: exact, out-of-core, submap-based SLAM", 2007). What was known of the devices before is part of it, and is taken
out: the network has it once, however many pairs a device belongs to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TypeVar

import numpy as np

from calib.estimation import CONVERGED, Fit, Noise, Term
from calib.geometry import IDENTITY, NO_FACE, Matches, Size, cross_matrix, depths_of_rays, tangent_basis
from calib.networks.diagnostics import Strain, not_connected
from calib.networks.estimate import NetworkEstimate, checked_captures
from calib.networks.initialisation import FEWEST_TO_PLACE, ROUGH, Grown, placed, placed_before_wall, sees
from calib.networks.network import PER_NODE, PLACE, Device, Network
from calib.networks.observations import NetworkProblem, Overlaps, PairName
from calib.networks.prior import NetworkKnowledge
from calib.networks.shared_points import SharedPoints
from calib.networks.warps import Warps
from calib.numerics import Bools, Floats, Ints, covariance_of, evenly, inverse_of, robust_sigma
from calib.refinement import (
    CAMERA,
    PER_DEVICE,
    PROJECTOR,
    ROTATION,
    SHARED,
    SQUARENESS_DEG,
    TRANSLATION,
    Knowledge,
    KnownRig,
    LensPrior,
    Prior,
    State,
)
from calib.self_calibration import PrincipalPoint

_TURN = slice(PER_DEVICE, PLACE.start)  # of a device's columns
T = TypeVar("T")

_ROUNDS = 3  # of measuring the noise of shared pixels
_FEWEST_EXPECTED = 1.0  # degrees of freedom: a pair alone agrees with itself
_SAMPLE = 3000  # matches of a pair at a station


@dataclass(frozen=True, eq=False)
class CalibratedPair:
    """A camera and a projector of a network, by number, that are calibrated by themselves."""

    camera: int
    projector: int
    rig: KnownRig
    """As calibrated."""
    pull: Floats
    """(21,): half the gradient there of what it was calibrated from, without what was known before."""
    precision: Floats
    """(21, 21): the information of what it was calibrated from."""

    @classmethod
    def of(cls, camera: int, projector: int, rig: KnownRig, prior: Prior) -> "CalibratedPair":
        """`prior`: what was known when the rig was calibrated."""
        _, pull, curvature = prior.misfit(rig.state.additive())
        free = np.flatnonzero(np.diag(rig.covariance) > 0)
        among = np.ix_(free, free)
        information = inverse_of(rig.covariance[among])
        scale = np.sqrt(np.diag(information))
        values, axes = np.linalg.eigh((information - np.diag(curvature[free])) / np.outer(scale, scale))
        precision = np.zeros((SHARED, SHARED))
        precision[among] = (axes * np.maximum(values, 0.0)) @ axes.T * np.outer(scale, scale)
        return cls(camera, projector, rig, np.where(np.diag(precision) > 0, -pull, 0.0), precision)

    def columns(self, network: Network) -> Ints:
        """Those of the camera and the projector, (36,)."""
        every = np.arange(network.size, dtype=np.int32)
        return np.concatenate([every[network.device_columns(device)] for device in (self.camera, self.projector)])

    def misfit(self, network: Network) -> Term:
        """The cost of another rig."""
        step, by_rig = self.rig.linearised(self.rig_in(network))
        by_columns = by_rig @ self._by_columns(network)
        pull = self.precision @ step
        cost, gradient = float(step @ (pull + 2 * self.pull)), by_columns.T @ (pull + self.pull)
        return Term(cost, gradient, by_columns.T @ self.precision @ by_columns, self.columns(network))

    def disagreement(self, network: Network, covariance: Floats) -> tuple[float, float]:
        """χ² of how far the pair as calibrated is from what it is in the most likely network, and its expected value.

        `covariance` (size, size): of the network. An estimate from part of what another one is from differs from it by
        the difference of their covariances (Hausman, "Specification tests in econometrics", 1978).
        """
        step, by_rig = self.rig.linearised(self.rig_in(network))
        by_columns, columns = by_rig @ self._by_columns(network), self.columns(network)
        free = np.flatnonzero(np.diag(self.rig.covariance) > 0)
        alone = self.rig.covariance[np.ix_(free, free)]
        together = (by_columns @ covariance[np.ix_(columns, columns)] @ by_columns.T)[np.ix_(free, free)]
        information = inverse_of(alone)
        square = float(step[free] @ information @ step[free])
        return square, float(np.trace(information @ (alone - together)))

    def rig_in(self, network: Network) -> State:
        """What the pair is in a network, in its own baselines."""
        camera, projector = network.devices[self.camera], network.devices[self.projector]
        return State(camera.lens, projector.lens, (projector.pose.inverse() @ camera.pose).in_baselines)

    def _by_columns(self, network: Network) -> Floats:
        """Derivatives (21, 36) of the rig by `columns`."""
        camera, projector = network.devices[self.camera], network.devices[self.projector]
        back, apart = projector.pose.rotation.T, camera.pose.translation - projector.pose.translation
        length = float(np.linalg.norm(apart))
        aside = tangent_basis(back @ apart / length).T @ back / length
        derivatives = np.zeros((SHARED, 2 * PER_NODE))
        of_camera, of_projector = derivatives[:, :PER_NODE], derivatives[:, PER_NODE:]
        of_camera[CAMERA, :PER_DEVICE] = of_projector[PROJECTOR, :PER_DEVICE] = np.eye(PER_DEVICE)
        of_camera[ROTATION, _TURN], of_projector[ROTATION, _TURN] = back, -back
        of_camera[TRANSLATION, PLACE], of_projector[TRANSLATION, PLACE] = aside, -aside
        of_projector[TRANSLATION, _TURN] = aside @ cross_matrix(apart)
        return derivatives


@dataclass(frozen=True, eq=False)
class _Stations:
    """What all pairs saw at all stations."""

    captures: Sequence[Mapping[PairName, Matches]]
    """Without labels."""
    overlaps: Sequence[Overlaps]
    rigs: Mapping[PairName, KnownRig]
    knowledge: NetworkKnowledge

    @property
    def pairs(self) -> list[PairName]:
        """All of them."""
        return list(dict.fromkeys(chain.from_iterable(self.captures)))

    def known_points(self, network: Network, names: tuple[str, ...], hub: str, new: str) -> tuple[Floats, Floats]:
        """Points (N, 3) that placed pairs of a `hub` tell at all stations, and the pixels (N, 2) of a `new` device."""
        devices = dict(zip(names, network.devices, strict=True))
        points, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
        for captures, overlaps in zip(self.captures, self.overlaps, strict=True):
            if (hub, new) in overlaps.sightings:
                station_points, observed = overlaps.known_points(devices, hub, new, _among(captures, names))
                points.append(station_points)
                pixels.append(observed)
        return np.concatenate(points), np.concatenate(pixels)

    def calibrated(self, names: tuple[str, ...]) -> dict[PairName, CalibratedPair]:
        """Pairs of placed devices that are calibrated by themselves."""
        return {
            (camera, projector): CalibratedPair.of(
                names.index(camera),
                names.index(projector),
                rig,
                self._known_before(camera, projector).prior(rig.state),
            )
            for (camera, projector), rig in _among(self.rigs, names).items()
        }

    def disagreements(
        self, network: Network, names: tuple[str, ...], covariance: Floats
    ) -> dict[PairName, tuple[float, float]]:
        """Of each calibrated pair with the network, as of `CalibratedPair.disagreement`."""
        pairs = self.calibrated(names)
        return {name: pair.disagreement(network, covariance) for name, pair in pairs.items()}

    def factors(self, network: Network, names: tuple[str, ...]) -> list[CalibratedPair | SharedPoints]:
        """What calibrated pairs are, and what ties pairs, under a network that is nearly right."""
        factors: list[CalibratedPair | SharedPoints] = [*self.calibrated(names).values()]
        for captures, overlaps in zip(self.captures, self.overlaps, strict=True):
            factors += overlaps.joints(network, names, _among(captures, names), self.rigs)
        return factors

    def _known_before(self, camera: str, projector: str) -> Knowledge:
        known, point = self.knowledge, self.knowledge.point(camera)
        sizes, lenses = (known.sizes[camera], known.sizes[projector]), (known.lens(camera), known.lens(projector))
        return Knowledge(*sizes, point.px, point.sigma_px, known.squareness_deg, lenses=lenses)


def estimate_from_pairs(
    stations: Sequence[Mapping[PairName, Matches]],
    rigs: Mapping[PairName, KnownRig],
    sizes: Mapping[str, Size],
    *,
    lenses: Mapping[str, LensPrior] | None = None,
    points: Mapping[str, PrincipalPoint] | None = None,
) -> NetworkEstimate:
    """From the matches of each pair (camera, projector) at each station, and pairs that are calibrated by themselves.

    What is known of `lenses`, and of cameras' principal `points`, by name, was known to the `rigs` as well. The pair
    whose camera's focal length is known best gives the unit of length. No number is of a plane.

    Raises RefusalError if a device does not connect or is mirrored; ValueError for no rig, fewer than two pairs, or a
    device without a size or with both roles.
    """
    if not rigs:
        raise ValueError("a network from pairs needs one that is calibrated, found none")
    captures = [
        {
            pair: matches.with_faces(np.full(len(matches), NO_FACE, np.int32))
            for pair, matches in checked_captures(station, sizes).items()
        }
        for station in stations
    ]
    cameras = frozenset(camera for station in captures for camera, _ in station)
    knowledge = NetworkKnowledge(sizes, cameras, SQUARENESS_DEG, lenses or {}, points or {})
    observations = _Stations(captures, [Overlaps.of(station, sizes) for station in captures], rigs, knowledge)
    seed = min(rigs, key=lambda pair: float(rigs[pair].covariance[0, 0]))
    names: tuple[str, ...] = seed
    network = _seeded(rigs[seed], seed, sizes)
    while len(names) < len({name for pair in observations.pairs for name in pair}):
        more = _with_next(observations, network, names)
        if more is None:
            raise not_connected(_as_grown(observations, network, names))
        network, names = more
    free = knowledge.free(network, names)
    for number in range(_ROUNDS):
        fit = _fitted(observations, network, names, free, CONVERGED if number == _ROUNDS - 1 else ROUGH)
        network = fit.state
    covariance = covariance_of(fit.information, free)
    disagreements = observations.disagreements(network, names, covariance)
    square, expected = np.sum([*disagreements.values()], axis=0)
    # As of measurements that disagree (Birge, "The calculation of errors by the method of least squares", 1932).
    covariance *= max(1.0, square / max(expected, _FEWEST_EXPECTED))
    noise = {pair: Noise(_match_px(observations, pair), 0.0, 0.0, 1.0) for pair in observations.pairs}
    return NetworkEstimate(
        names,
        sizes,
        fit,
        covariance,
        noise,
        (seed[0], seed[1]),
        (),
        np.zeros(0),
        Warps(),
        {pair: _strain(observations, network, names, pair, noise[pair].match_px) for pair in observations.pairs},
        {
            pair: float(np.sqrt(square / max(expected, _FEWEST_EXPECTED)))
            for pair, (square, expected) in disagreements.items()
        },
    )


def _among(pairs: Mapping[PairName, T], names: Sequence[str]) -> dict[PairName, T]:
    """Those of placed devices."""
    return {pair: value for pair, value in pairs.items() if set(pair) <= set(names)}


def _seeded(rig: KnownRig, pair: PairName, sizes: Mapping[str, Size]) -> Network:
    camera, projector, state = sizes[pair[0]], sizes[pair[1]], rig.state
    return Network(
        (Device(state.camera, IDENTITY, camera), Device(state.projector, state.pose.inverse(), projector)), ()
    )


def _with_next(stations: _Stations, network: Network, names: tuple[str, ...]) -> tuple[Network, tuple[str, ...]] | None:
    """With the device that most known points place; None if none can be."""
    candidates = []
    for pair in stations.pairs:
        for hub, new in (pair, pair[::-1]):
            if hub in names and new not in names:
                points, pixels = stations.known_points(network, names, hub, new)
                some = evenly(np.ones(len(points), np.bool_), _SAMPLE)
                candidates.append((len(points), new, points[some], pixels[some]))
    candidates.sort(key=lambda candidate: -candidate[0])
    for on_one_plane in (False, True):
        for count, new, points, pixels in candidates:
            if count < FEWEST_TO_PLACE:
                continue
            size, point = stations.knowledge.sizes[new], stations.knowledge.point(new)
            device = (
                placed_before_wall(points, pixels, size, point.px) if on_one_plane else placed(points, pixels, size)
            )
            if device is None or not sees(device, points, pixels):
                continue
            more, named = (
                replace(network, devices=(*network.devices, stations.knowledge.held(new, device))),
                (*names, new),
            )
            alone = np.zeros(more.size, np.bool_)
            alone[more.device_columns(len(names))] = True
            fit = _fitted(stations, more, named, alone & stations.knowledge.free(more, named), ROUGH)
            return fit.state, named
    return None


def _fitted(
    stations: _Stations, network: Network, names: tuple[str, ...], free: Bools, tolerance: float
) -> Fit[Network]:
    prior = replace(stations.knowledge.prior(names), square=())
    return NetworkProblem((), (), prior, free, stations.factors(network, names)).minimise(network, tolerance=tolerance)


def _as_grown(stations: _Stations, network: Network, names: tuple[str, ...]) -> Grown:
    """The first station, by which to say what is missing."""
    captures = stations.captures[0]
    return Grown(names, network, _among(captures, names), (), captures, stations.overlaps[0], stations.knowledge)


def _match_px(stations: _Stations, pair: PairName) -> float:
    """Noise of a pair's matches in projector pixels."""
    return float(np.nanmedian([overlaps.match_px(pair) for overlaps in stations.overlaps]))


def _strain(stations: _Stations, network: Network, names: tuple[str, ...], pair: PairName, noise_px: float) -> Strain:
    """How far a pair's matches are off their epipolar lines, at the station where they are furthest."""
    camera, projector = (names.index(name) for name in pair)
    furthest = 0.0
    for captures in stations.captures:
        if pair not in captures:
            continue
        some = captures[pair][evenly(np.ones(len(captures[pair]), np.bool_), _SAMPLE)]
        rays, lines = (
            network.devices[device].pose.rotate(network.devices[device].rays(pixels)[0])
            for device, pixels in ((camera, some.camera_px), (projector, some.projector_px))
        )
        apart = network.devices[camera].pose.translation - network.devices[projector].pose.translation
        depth = depths_of_rays(rays, lines, apart)[:, 0]
        alone = np.full((len(some), 1), noise_px**2)
        points = SharedPoints(camera, (projector,), some.camera_px, some.projector_px[:, None], alone, depth)
        _, across = points.relative(network)
        furthest = max(furthest, noise_px * robust_sigma(across))
    return Strain(furthest, noise_px, 0.0)
