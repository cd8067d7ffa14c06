"""One maximum-likelihood estimate of all devices of a network and the planes that they share."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import FACES, NO_FACE, Intrinsics, Matches, Motion, Size, intersect
from calib.networks.growth import placed, with_labels
from calib.networks.network import Device, Network
from calib.networks.prior import NetworkKnowledge, NetworkPrior
from calib.networks.sights import Sight, points_on
from calib.numerics import Bools, Floats, evenly
from calib.refinement import (
    PER_DEVICE,
    SQUARENESS_DEG,
    LensPrior,
    Noise,
    Shifts,
    covariance_of,
    device_of,
    into_cells,
)
from calib.refusal import RefusalError
from calib.rooms.flatness import covariance_of_waves
from calib.rooms.likelihood import CONVERGED, Fit, minimise
from calib.rooms.noise import measured
from calib.rooms.planes import plane_through
from calib.rooms.smooth_errors import covariance_of_shifts
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate

PairName = tuple[str, str]  # camera, projector

_LEAST_ON_PLANE = 100  # matches; fewer may be strays
_SAMPLE = 3_000
_ROUGH = 0.1  # in cost
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class NetworkEstimate:
    """`names`: of the devices, in the network's order. `covariance` (size, size) of the network's columns, 0 for what
    was held. `noise`: of each pair. `seed`: the pair whose distance is the unit of length. `waves` (P,): by how much
    each plane is not flat, root mean square; 0 where nothing shows it.
    """

    names: tuple[str, ...]
    sizes: Mapping[str, Size]
    fit: Fit[Network]
    covariance: Floats
    noise: Mapping[PairName, Noise]
    seed: PairName
    sights: tuple[Sight, ...]
    waves: Floats

    @property
    def network(self) -> Network:
        """The most likely one."""
        return self.fit.layout

    def device(self, name: str) -> Device:
        """One of the devices."""
        return self.network.devices[self.names.index(name)]

    def intrinsics(self, name: str) -> Intrinsics:
        """Of one of the devices."""
        focal, x0, y0, *terms = (float(value) for value in self.device(name).lens)
        k1, k2, p1, p2, k3 = terms
        return Intrinsics(*self.sizes[name], (focal, focal), (x0, y0), (k1, k2, p1, p2, k3))

    def sigmas(self, name: str) -> Floats:
        """Standard deviations (14,) of log f, x_0, y_0 in px, k1, k2, p1, p2, k3, turn in radians, and translation."""
        columns = self.network.device_columns(self.names.index(name))
        return np.sqrt(np.diag(self.covariance)[columns])


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
    All other pairs' labels are found through the devices that they share with it.

    Raises RefusalError if no pair's corner calibrates it, or a device does not connect; ValueError for fewer than two
    pairs, or a device without a size or with both roles.
    """
    _refuse_wrong_input(captures, sizes)
    cameras = frozenset(camera for camera, _ in captures)
    knowledge = NetworkKnowledge(sizes, cameras, squareness_deg, lenses or {}, points or {})
    seed, start = _seed(captures, knowledge)
    grown = _Grown.from_corner(seed, captures, start, knowledge)
    while grown.waiting:
        grown = grown.with_next()
    return grown.estimate(shifts or {})


def _refuse_wrong_input(captures: Mapping[PairName, Matches], sizes: Mapping[str, Size]) -> None:
    if len(captures) < 2:
        raise ValueError(f"a network needs two pairs of camera and projector or more, found {len(captures)}")
    cameras, projectors = ({pair[role] for pair in captures} for role in (0, 1))
    if cameras & projectors:
        raise ValueError(f"'{min(cameras & projectors)}' is the name of a camera and of a projector")
    if missing := (cameras | projectors) - set(sizes):
        raise ValueError(f"'{min(missing)}' has no image size")


def _seed(captures: Mapping[PairName, Matches], knowledge: NetworkKnowledge) -> tuple[PairName, SelfCalibration]:
    """The pair whose corner tells most of its camera's focal length, and what it tells."""
    refusals: list[RefusalError] = []
    found: list[tuple[float, PairName, SelfCalibration]] = []
    for pair, matches in captures.items():
        if matches.face is None or matches.on_each_face.min() < _LEAST_ON_PLANE:
            continue
        camera, projector = pair
        faces = matches.with_faces(np.where(matches.face < len(FACES), matches.face, NO_FACE))
        try:
            calibrated = self_calibrate(
                faces,
                knowledge.sizes[camera],
                knowledge.sizes[projector],
                principal_point=knowledge.point(camera),
                squareness_deg=knowledge.squareness_deg,
                lenses=(knowledge.lens(camera), knowledge.lens(projector)),
            )
        except RefusalError as refusal:
            refusals.append(refusal)
            continue
        focal_px = calibrated.calibration.sigma.camera.focal_px
        sigma = np.inf if focal_px is None else focal_px[0] / calibrated.calibration.camera.focal_px[0]
        found.append((sigma, pair, calibrated))
    if found:
        _, pair, calibrated = min(found, key=lambda each: each[0])
        return pair, calibrated
    if refusals:
        raise refusals[0]
    raise RefusalError(
        "No camera sees three faces of a corner in one projector's light.",
        "Turn one projector and one camera towards a corner of the room; the others follow from there.",
    )


@dataclass(frozen=True, eq=False)
class _Grown:
    """As far as devices are placed. `labelled`: matches of pairs that are part of it, with labels of its planes."""

    names: tuple[str, ...]
    network: Network
    labelled: Mapping[PairName, Matches]
    sights: tuple[Sight, ...]
    labels: tuple[int, ...]
    captures: Mapping[PairName, Matches]
    knowledge: NetworkKnowledge

    @classmethod
    def from_corner(
        cls,
        seed: PairName,
        captures: Mapping[PairName, Matches],
        start: SelfCalibration,
        knowledge: NetworkKnowledge,
    ) -> "_Grown":
        """One pair as calibrated, and the planes through its matches."""
        rig, matches = start.calibration, captures[seed]
        back = rig.rotation.T
        devices = (
            Device(device_of(rig.camera), Motion(np.eye(3), np.zeros(3))),
            Device(device_of(rig.projector), Motion(back, -back @ rig.translation)),
        )
        count = np.bincount(matches.labels[matches.labels >= 0])
        labels = tuple(int(label) for label in np.flatnonzero(count >= _LEAST_ON_PLANE))
        planes = []
        for label in labels:
            own = matches[evenly(matches.labels == label, _SAMPLE)]
            points = intersect(own, rig).points
            points = points[np.isfinite(points).all(axis=1)]
            planes.append(plane_through(points, np.ones(len(points))))
        empty = cls(seed, Network(devices, tuple(planes)), {}, (), labels, captures, knowledge)
        return empty._with_pair(seed, matches)

    @property
    def waiting(self) -> tuple[PairName, ...]:
        """Pairs that are no part of it yet."""
        return tuple(pair for pair in self.captures if pair not in self.labelled)

    def with_next(self) -> "_Grown":
        """With one pair more: of two placed devices, or else the one that places a new device by most matches."""
        best: tuple[int, PairName, Matches] | None = None
        for pair in self.waiting:
            there = [name in self.names for name in pair]
            if not any(there):
                continue
            matches = self._labelled(pair)
            if all(there):
                return self._with_pair(pair, matches)
            count = np.bincount(matches.labels[matches.labels >= 0], minlength=1)
            if np.count_nonzero(count >= _LEAST_ON_PLANE) >= 2 and (best is None or count.sum() > best[0]):
                best = int(count.sum()), pair, matches
        if best is not None and (more := self._with_device(*best[1:])) is not None:
            return more
        loose = sorted({name for pair in self.waiting for name in pair} - set(self.names))
        raise RefusalError(
            f"{', '.join(loose)}: not connected with {', '.join(self.names)}.",
            "Let them share light on two walls at least: a camera that sees two projectors' light in one place, or a "
            "projector whose light two cameras see.",
        )

    def _labelled(self, pair: PairName) -> Matches:
        camera, projector = pair
        others = self.labelled.items()
        return with_labels(
            self.captures[pair],
            [matches for (c, _), matches in others if c == camera],
            [matches for (_, p), matches in others if p == projector],
        )

    def _with_device(self, pair: PairName, matches: Matches) -> "_Grown | None":
        """The device of a pair that is not placed yet, by the points that the other one sees on planes."""
        new = 0 if pair[0] not in self.names else 1
        pixels = matches.camera_px, matches.projector_px
        known = self.network.devices[self.names.index(pair[1 - new])]
        points, seen = [], []
        for label, plane in zip(self.labels, self.network.planes, strict=True):
            own = evenly(matches.labels == label, _SAMPLE)
            points.append(points_on(pixels[1 - new][own], known.lens, known.pose, plane))
            seen.append(pixels[new][own])
        found = placed(np.concatenate(points), np.concatenate(seen))
        if found is None:
            return None
        device = self.knowledge.held(pair[new], found)
        network = Network((*self.network.devices, device), self.network.planes)
        more = replace(self, names=(*self.names, pair[new]), network=network)._with_pair(pair, matches)
        alone = np.zeros(network.size, np.bool_)
        alone[network.device_columns(len(self.names))] = True
        return more._settled(alone & more._free)._settled()

    def _with_pair(self, pair: PairName, matches: Matches) -> "_Grown":
        count = np.bincount(matches.labels[matches.labels >= 0], minlength=max(self.labels) + 1)
        labels = [label for label in self.labels if count[label] >= _LEAST_ON_PLANE]
        cells = into_cells(matches, labels) if labels else None
        camera, projector = (self.names.index(name) for name in pair)
        own = [
            Sight(len(self.labelled), camera, projector, self.labels.index(label), cells[cells.plane == label])
            for label in labels
            if cells is not None
        ]
        return replace(self, labelled={**self.labelled, pair: matches}, sights=(*self.sights, *own))

    @property
    def _prior(self) -> NetworkPrior:
        return self.knowledge.prior(self.names)

    @property
    def _free(self) -> Bools:
        free = np.ones(self.network.size, np.bool_)
        free[self.network.device_columns(0)][PER_DEVICE:] = False
        for i, sigma in enumerate(self._prior.sigma):
            free[self.network.device_columns(i)][:PER_DEVICE] = sigma > 0
        return free

    def _settled(self, free: Bools | None = None) -> "_Grown":
        variances = [sight.cells.sigma_px**2 for sight in self.sights]
        chosen = self._free if free is None else free
        fit = minimise(self.sights, self.network, self._prior, variances, chosen, tolerance=_ROUGH)
        return replace(self, network=fit.layout)

    def estimate(self, shifts: Mapping[PairName, Shifts]) -> NetworkEstimate:
        """All of it at once, with the noise that its residuals show."""
        free, prior, pairs = self._free, self._prior, tuple(self.labelled)
        variances = [sight.cells.sigma_px**2 for sight in self.sights]
        fit = minimise(self.sights, self.network, prior, variances, free, tolerance=_ROUGH)
        for last in range(_ROUNDS):
            levels = measured(self.sights, fit, variances, free, [1] * len(pairs), one_rig=False)
            variances = levels.variances(self.sights)
            tolerance = CONVERGED if last == _ROUNDS - 1 else _ROUGH
            fit = minimise(self.sights, fit.layout, prior, variances, free, tolerance=tolerance)
        of_waves, waves = covariance_of_waves(self.sights, fit, variances, free, levels)
        of_shifts = [shifts.get(pair, Shifts()) for pair in pairs]
        covariance = covariance_of(fit.information, free) + of_waves
        covariance += covariance_of_shifts(self.sights, fit, variances, free, levels, of_shifts)
        noise = dict(zip(pairs, levels.stations, strict=True))
        return NetworkEstimate(
            self.names, self.knowledge.sizes, fit, covariance, noise, (self.names[0], self.names[1]), self.sights, waves
        )
