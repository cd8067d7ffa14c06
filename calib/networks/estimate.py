"""One maximum-likelihood estimate of all devices of a network and the planes that they share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation import (
    CONVERGED,
    WRONG_ASSOCIATION,
    Fit,
    Noise,
    Shifts,
    association_scores,
    covariance_of_shifts,
    separate_plane,
)
from calib.finding import FindingKind
from calib.geometry import FACES, NO_FACE, PER_PLANE, Intrinsics, Matches, Size
from calib.networks.diagnostics import Strain, not_connected, refuse_mirrored, standing_alike, strains
from calib.networks.initialisation import ROUGH, Grown
from calib.networks.network import WARP, Device, Network
from calib.networks.observations import NetworkProblem, PairName, PlaneObservation
from calib.networks.prior import NetworkKnowledge
from calib.networks.warps import (
    Explanation,
    Warps,
    find_warps,
    is_strained,
    likeliest,
    moves,
    or_moved,
    warped,
    weighed,
)
from calib.networks.weights import Weights
from calib.numerics import Floats, evenly
from calib.refinement import SQUARENESS_DEG, LensPrior
from calib.refusal import RefusalError
from calib.self_calibration import Method, PrincipalPoint, SelfCalibration, self_calibrate

_LEAST_ON_FACE = 100  # matches; fewer may be strays
_MOST = 200_000  # matches of a pair, to twice as many: their mean noise is far below that of any lens's model
_METHODS: tuple[Method, ...] = ("refined", "paper")
_ROUNDS = 4
_IN_FRONT = 0.98  # of a sight's cells
_EXPLAINED = 2 / 3  # of the cost remains: where walls are not flat, any further parameter lowers it a little

NO_CORNER_IN_NETWORK = FindingKind(
    "no-corner-in-network",
    "No camera of a network sees three faces of a corner in one projector's light.",
    "Turn one projector and one camera towards a corner of the room; the others follow from there. Or take three "
    "stations or more of something with a pattern, turned and tipped by 10 to 30° in between.",
)


@dataclass(frozen=True, eq=False)
class NetworkEstimate:
    """Devices and planes of a network by one estimate, with what tests it."""

    names: tuple[str, ...]
    """Of the devices, in the network's order."""
    sizes: Mapping[str, Size]
    fit: Fit[Network]
    covariance: Floats
    """Of the network's columns, 0 for what was held, (size, size)."""
    noise: Mapping[PairName, Noise]
    """Of each pair."""
    seed: PairName
    """The pair whose distance is the unit of length."""
    sights: Sequence[PlaneObservation]
    waves: Floats
    """By how much each plane is not flat, root mean square, (P,); 0 where nothing shows it."""
    warps: Warps
    """Whose picture seems to be warped."""
    strains: Mapping[PairName, Strain]
    """Of each pair that sees a plane, or that was calibrated by itself."""
    disagreements: Mapping[PairName, float] = field(default_factory=dict)
    """Of pairs that were, by how many sigmas they are off, root mean square; none where a corner calibrates the
    network.
    """

    @property
    def network(self) -> Network:
        """The most likely one."""
        return self.fit.state

    def device(self, name: str) -> Device:
        """One of the devices."""
        return self.network.devices[self.names.index(name)]

    def intrinsics(self, name: str) -> Intrinsics:
        """Of one of the devices."""
        return Intrinsics.of_device(self.device(name).lens, self.sizes[name])

    def sigmas(self, name: str) -> Floats:
        """Standard deviations (14,) of log f, x_0, y_0 in px, k1, k2, p1, p2, k3, turn in radians, and translation."""
        columns = self.network.device_columns(self.names.index(name))
        return np.sqrt(np.diag(self.covariance)[columns][: WARP.start])

    @property
    def alike(self) -> list[tuple[str, str, float]]:
        """Devices that stand almost in one place, with their distance over that of what they see."""
        return standing_alike(self.names, self.sights, self.network)


def estimate_network(
    captures: Mapping[PairName, Matches],
    sizes: Mapping[str, Size],
    *,
    squareness_deg: float = SQUARENESS_DEG,
    lenses: Mapping[str, LensPrior] | None = None,
    points: Mapping[str, PrincipalPoint] | None = None,
    shifts: Mapping[PairName, Shifts] | None = None,
) -> NetworkEstimate:
    """From the matches of each pair (camera, projector) with light in common, and each device's image size.

    What is known of `lenses`, and of cameras' principal `points`, by name; a sigma of 0 holds it. `shifts`: by what
    matches of a pair may be shifted, for the covariance.

    At least one pair sees a corner: its matches have the labels 0, 1, 2 on the faces, and further ones on other planes.
    All others follow by what they share with it: planes, whose labels travel along shared pixels, or any surface.

    Raises RefusalError if no pair's corner calibrates it, or a device does not connect or is mirrored; ValueError for
    fewer than two pairs, or a device without a size or with both roles.
    """
    captures = checked_captures(captures, sizes)
    cameras = frozenset(camera for camera, _ in captures)
    knowledge = NetworkKnowledge(sizes, cameras, squareness_deg, lenses or {}, points or {})
    seed, start = _seed(captures, knowledge)
    grown = Grown.from_corner(seed, captures, start, knowledge)
    while grown.waiting:
        more = grown.with_next()
        if more is None:
            raise not_connected(grown)
        grown = more
    return _estimated(grown.labelled_anew(), shifts or {})


def checked_captures(captures: Mapping[PairName, Matches], sizes: Mapping[str, Size]) -> dict[PairName, Matches]:
    """No more matches of each pair than are of use. Raises RefusalError for a device that is mirrored, ValueError for
    fewer than two pairs, or a device without a size or with both roles.
    """
    _refuse_wrong_input(captures, sizes)
    refuse_mirrored(captures, sizes)
    return {pair: matches[evenly(np.ones(len(matches), np.bool_), _MOST)] for pair, matches in captures.items()}


def _refuse_wrong_input(captures: Mapping[PairName, Matches], sizes: Mapping[str, Size]) -> None:
    if len(captures) < 2:
        raise ValueError(f"a network needs two pairs of camera and projector or more, found {len(captures)}")
    cameras, projectors = ({pair[role] for pair in captures} for role in (0, 1))
    if cameras & projectors:
        raise ValueError(f"'{min(cameras & projectors)}' is the name of a camera and of a projector")
    if missing := (cameras | projectors) - set(sizes):
        raise ValueError(f"'{min(missing)}' has no image size")


def _seed(captures: Mapping[PairName, Matches], knowledge: NetworkKnowledge) -> tuple[PairName, SelfCalibration]:
    """The pair whose corner tells most of its camera's focal length, and what it tells.

    Where no corner calibrates a pair alone, as of walls that are not flat, one is taken that has a closed form, where
    there are several cameras and projectors: together they tell whether that leads to anything.
    """
    cornered = {
        pair: matches.with_faces(np.where(matches.face < len(FACES), matches.face, NO_FACE))
        for pair, matches in captures.items()
        if matches.face is not None and matches.on_each_face.min() >= _LEAST_ON_FACE
    }
    if not cornered:
        raise RefusalError(
            NO_CORNER_IN_NETWORK,
            "No camera sees three faces of a corner in one projector's light.",
            NO_CORNER_IN_NETWORK.remedy,
        )
    refusals: list[RefusalError] = []
    # With one camera, or one projector, nothing tells that a poor start ended in a wrong minimum.
    several = min(len({pair[role] for pair in captures}) for role in (0, 1)) > 1
    for method in _METHODS if several else _METHODS[:1]:
        calibrations: list[tuple[float, PairName, SelfCalibration]] = []
        for pair, matches in cornered.items():
            try:
                calibrated = _calibrated(pair, matches, knowledge, method)
            except RefusalError as refusal:
                refusals.append(refusal)
                continue
            focal_px = calibrated.calibration.sigma.camera.focal_px
            sigma = 1 / len(matches) if focal_px is None else focal_px[0] / calibrated.calibration.camera.focal_px[0]
            calibrations.append((sigma, pair, calibrated))
        if calibrations:
            _, pair, calibrated = min(calibrations, key=lambda entry: entry[0])
            return pair, calibrated
    raise refusals[0]


def _calibrated(pair: PairName, matches: Matches, knowledge: NetworkKnowledge, method: Method) -> SelfCalibration:
    camera, projector = pair
    return self_calibrate(
        matches,
        knowledge.sizes[camera],
        knowledge.sizes[projector],
        principal_point=knowledge.point(camera),
        method=method,
        squareness_deg=knowledge.squareness_deg,
        lenses=(knowledge.lens(camera), knowledge.lens(projector)),
    )


def _first_fit(grown: Grown) -> tuple[Sequence[PlaneObservation], Fit[Network], str]:
    """The sights to use, a fit to them, and the device that was moved between its captures, if one was.

    Sights that end behind a device are left out. Those that are not on the plane that they were taken for have planes
    of their own, unless one device that was moved, or warped pictures, are likelier than all of these.
    """
    tied, fit = _fit_in_front(grown, grown.network, grown.sights)
    untied, untied_fit = _without_wrong_associations(grown, tied, fit)
    wrong = len(untied_fit.state.planes) - len(fit.state.planes)
    if not wrong and not is_strained(untied.parts, fit):
        return tied.parts, fit, ""
    alone = replace(untied, joints=()).minimise(untied_fit.state, tolerance=ROUGH)
    as_it_is = Explanation(alone, untied.parts, PER_PLANE * wrong)
    likely = likeliest(as_it_is, [*moves(grown, tied.parts, fit.state), warped(grown, tied.parts, fit)])
    if likely is as_it_is or likely.fit.cost > _EXPLAINED * fit.cost:
        return untied.parts, untied_fit, ""
    return tied.parts, fit, likely.moved


def _fit_in_front(
    grown: Grown, network: Network, sights: Sequence[PlaneObservation]
) -> tuple[NetworkProblem, Fit[Network]]:
    """A fit near a network, without sights that end behind a device."""
    network, kept = _in_front(network, sights)
    while True:
        problem = replace(grown.problem(network, kept), joints=grown.joints(network))
        fit = problem.minimise(network, tolerance=ROUGH)
        network, kept = _in_front(fit.state, kept)
        if len(kept) == len(problem.parts):
            return problem, fit


def _without_wrong_associations(
    grown: Grown, problem: NetworkProblem, fit: Fit[Network]
) -> tuple[NetworkProblem, Fit[Network]]:
    """With planes of their own for sights that are not on the plane that they were taken for."""
    while True:
        scores, freedom = association_scores(problem, fit)
        per_freedom = np.where(freedom > 0, scores / np.maximum(freedom, 1), 0.0)
        limit = (
            WRONG_ASSOCIATION * max(float(np.median(per_freedom[freedom > 0])), 1.0) if (freedom > 0).any() else np.inf
        )
        network, sights = fit.state, tuple(problem.parts)
        for plane in range(len(network.planes)):
            worst = max((i for i, s in enumerate(sights) if s.plane == plane), key=lambda i: float(per_freedom[i]))
            if per_freedom[worst] > limit:
                network, sights = separate_plane(network, sights, worst)
        if len(network.planes) == len(fit.state.planes):
            return problem, fit
        problem, fit = _fit_in_front(grown, network, sights)


def _in_front(network: Network, sights: Sequence[PlaneObservation]) -> tuple[Network, tuple[PlaneObservation, ...]]:
    """Sights that are before both devices, all but strays, and the planes that have one."""
    kept = [sight for sight in sights if np.mean((sight.predict(network)[2] > 0).all(axis=1)) >= _IN_FRONT]
    planes_kept = sorted({sight.plane for sight in kept})
    planes = tuple(network.planes[plane] for plane in planes_kept)
    return replace(network, planes=planes), tuple(
        replace(sight, plane=planes_kept.index(sight.plane)) for sight in kept
    )


def _estimated(grown: Grown, shifts: Mapping[PairName, Shifts]) -> NetworkEstimate:
    """All of it at once, with the noise that its residuals show."""
    pairs = tuple(grown.labelled)
    sights, fit, moved = _first_fit(grown)
    if moved:
        warps, weights = Warps(moved=moved), Weights(grown.problem(fit.state, sights), rough=True)
    else:
        warps, fit, weights = find_warps(grown, sights, fit)
    for last in range(_ROUNDS):
        levels, weights = weights.measured_anew(grown, fit)
        fit = weights.fitted(fit.state, CONVERGED if last == _ROUNDS - 1 else ROUGH)
    waves = np.zeros(len(fit.state.planes))
    for plane, surface in enumerate(weights.surfaces):
        heights = surface.solved(fit.state).amplitudes
        waves[plane] = np.sqrt(np.mean(np.square(np.concatenate(surface.modes) @ heights)))
    of_shifts = [shifts.get(pair, Shifts()) for pair in pairs]
    hidden, covariance = weighed(weights.problem, fit, grown.names, {camera for camera, _ in pairs})
    covariance += covariance_of_shifts(weights.problem, fit, levels, of_shifts)
    on_planes = {sight.capture for sight in sights}
    noise = {
        pair: level if i in on_planes else Noise(grown.overlaps.match_px(pair), 0.0, 0.0, 1.0)
        for i, (pair, level) in enumerate(zip(pairs, levels.stations, strict=True))
    }
    return NetworkEstimate(
        grown.names,
        grown.knowledge.sizes,
        fit,
        covariance,
        noise,
        (grown.names[0], grown.names[1]),
        sights,
        waves,
        warps if moved else or_moved(warps or hidden, grown, sights, fit),
        {pairs[capture]: strain for capture, strain in strains(sights, fit).items()},
    )
