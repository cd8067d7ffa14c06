"""Incremental initialisation of a network, from one pair that is calibrated by a corner.

Device after device is placed by points known so far. Points are known on planes, which labels tell, and where a placed
device shares pixels with two others. Each new device starts from the direct linear transform, or from the homography of
a wall, and the joint estimate takes it from there.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.closed_form import resected
from calib.estimation import into_cells
from calib.geometry import (
    IDENTITY,
    NO_FACE,
    Matches,
    Plane,
    Pose,
    Size,
    homography_between,
    nearest_depths,
    project,
    unproject,
)
from calib.networks.network import Device, Network
from calib.networks.observations import NetworkProblem, Overlaps, PairName, PlaneObservation, pixels_of, points_on
from calib.networks.prior import NetworkKnowledge
from calib.networks.raster import label_map, read
from calib.networks.shared_points import SharedPoints
from calib.numerics import Bools, Floats, evenly
from calib.refinement import device_of
from calib.self_calibration import SelfCalibration

_USUAL_FOCAL = 1.2  # image widths
_FOCALS = 0.3, 4.0  # of ordinary devices, in image widths
_OFF = 0.05  # of the image's width: a device that sees known points further off is not there


def triangulated(camera: Device, projector: Device, camera_px: Floats, projector_px: Floats) -> Floats:
    """Points (N, 3) of a network on the camera's rays, where these are nearest to the projector's."""
    rays, back = (
        device.pose.rotate(unproject(device.lens, pixels)[0])
        for device, pixels in ((camera, camera_px), (projector, projector_px))
    )
    depth = nearest_depths(rays, back, camera.pose.translation - projector.pose.translation)[0]
    return camera.pose.translation + depth[:, None] * rays


def placed(points: Floats, pixels: Floats, size: Size) -> Device | None:
    """A device, without lens terms, that sees points (N, 3) at pixels (N, 2); None of points on one plane."""
    solution = resected(points, pixels)
    if solution is None:
        return None
    matrix, into_device = solution
    lens = np.array([np.sqrt(matrix[0, 0] * matrix[1, 1]), *matrix[:2, 2], 0.0, 0.0, 0.0, 0.0, 0.0])
    return Device(lens, into_device.inverse(), size)


def placed_before_wall(points: Floats, pixels: Floats, size: Size, point_px: tuple[float, float]) -> Device | None:
    """The same of points that are nearly on one plane, with square pixels and the principal point where it is expected.

    Both axes of the plane are perpendicular and of one length before the device (Zhang, "A flexible new technique for
    camera calibration", 2000). Where that tells no likely focal length, as straight before a wall, it is a usual one.
    """
    centre = points.mean(axis=0)
    _, spreads, axes = np.linalg.svd(points - centre, full_matrices=False)
    if not spreads[1] > 0:
        return None
    spread = float(spreads[0]) / np.sqrt(len(points))
    frame = np.stack([axes[0], axes[1], np.cross(axes[0], axes[1])], axis=1)
    homography = homography_between((points - centre) @ frame[:, :2] / spread, pixels - point_px) / size.width
    homography[2] *= size.width  # of pixels in image widths
    (first_column, second_column, _) = homography.T
    by_focal = np.array(
        [
            first_column[:2] @ second_column[:2],
            first_column[:2] @ first_column[:2] - second_column[:2] @ second_column[:2],
        ]
    )
    rest = np.array([first_column[2] * second_column[2], first_column[2] ** 2 - second_column[2] ** 2])
    inverse_square = -float(by_focal @ rest) / max(float(by_focal @ by_focal), 1e-300)
    focal = inverse_square**-0.5 if inverse_square > 0 else np.inf
    if not _FOCALS[0] < focal < _FOCALS[1]:
        focal = _USUAL_FOCAL
    before = homography / np.array([[focal], [focal], [1.0]])
    before *= np.sign(before[2, 2]) / np.sqrt(np.linalg.norm(before[:, 0]) * np.linalg.norm(before[:, 1]))
    left_vectors, _, right_vectors = np.linalg.svd(
        np.column_stack([before[:, 0], before[:, 1], np.cross(before[:, 0], before[:, 1])])
    )
    back = frame @ (left_vectors @ right_vectors).T
    lens = np.array([focal * size.width, *point_px, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Device(lens, Pose(back, centre - spread * (back @ before[:, 2])), size)


def sees(device: Device, points: Floats, pixels: Floats) -> bool:
    """Whether a device has known points (N, 3) about where they are seen, (N, 2)."""
    predicted, _, _ = project(device.lens, device.pose.undo(points))
    return bool(np.median(np.linalg.norm(predicted - pixels, axis=1)) < _OFF * device.size.width)


ROUGH = 0.1  # tolerance in cost
_LEAST_ON_PLANE = 100  # matches; fewer may be strays
_NEARLY_ALL = 0.9  # of a pair's matches on a plane that have labels: the others have the same
_PARALLEL, _ON_PLANE = float(np.cos(np.radians(3.0))), 0.01  # the latter of the distance
_SAMPLE = 3_000
_ROUNDS = 2
FEWEST_TO_PLACE = 30  # known points


@dataclass(frozen=True, eq=False)
class Grown:
    """As far as devices are placed. `labelled`: matches of pairs that are part of it, labelled by number of the plane.

    `sights`: in the order of these pairs.
    """

    names: tuple[str, ...]
    network: Network
    labelled: Mapping[PairName, Matches]
    sights: tuple[PlaneObservation, ...]
    captures: Mapping[PairName, Matches]
    overlaps: Overlaps
    knowledge: NetworkKnowledge

    @classmethod
    def from_corner(
        cls,
        seed: PairName,
        captures: Mapping[PairName, Matches],
        start: SelfCalibration,
        knowledge: NetworkKnowledge,
    ) -> "Grown":
        """One pair as calibrated, and the planes through its matches."""
        rig = start.calibration

        devices = (
            Device(device_of(rig.camera), IDENTITY, rig.camera.size),
            Device(device_of(rig.projector), rig.pose.inverse(), rig.projector.size),
        )
        overlaps = Overlaps.of(captures, knowledge.sizes)
        return cls(seed, Network(devices, ()), {}, (), captures, overlaps, knowledge)._with_pair(seed)

    @property
    def waiting(self) -> tuple[PairName, ...]:
        """Pairs that are no part of it yet."""
        return tuple(pair for pair in self.captures if pair not in self.labelled)

    def with_next(self) -> "Grown | None":
        """With one pair more: of two placed devices, or else the one that places a new device by most points; None if
        no device can be placed.
        """
        candidates: list[tuple[PairName, Floats, Floats]] = []
        for pair in self.waiting:
            there = [name in self.names for name in pair]
            if all(there):
                return self._with_pair(pair)
            if any(there):
                candidates.append((pair, *self._known_points(pair)))
        candidates.sort(key=lambda candidate: -len(candidate[1]))
        for on_one_plane in (False, True):
            for pair, points, pixels in candidates:
                new = pair[0] if pair[0] not in self.names else pair[1]
                size = self.knowledge.sizes[new]
                if len(points) < FEWEST_TO_PLACE:
                    continue
                device = (
                    placed_before_wall(points, pixels, size, self.knowledge.point(new).px)
                    if on_one_plane
                    else placed(points, pixels, size)
                )
                if device is not None and sees(device, points, pixels):
                    return self._with_device(pair, new, device)
        return None

    def free(self, network: Network) -> Bools:
        """Columns that are estimated, (size,)."""
        return self.knowledge.free(network, self.names)

    def joints(self, network: Network, bent: Collection[tuple[int, int]] = ()) -> tuple[SharedPoints, ...]:
        """What ties devices where matches are on no plane, or on one that is `bent`: number of the pair, label."""
        labelled = {
            pair: matches.with_faces(
                np.where(np.isin(matches.labels, [k for p, k in bent if p == i]), NO_FACE, matches.labels)
            )
            for i, (pair, matches) in enumerate(self.labelled.items())
        }
        return tuple(self.overlaps.joints(network, self.names, labelled))

    def problem(self, network: Network, sights: Sequence[PlaneObservation]) -> NetworkProblem:
        """What sights tell of it, near a network, by the scatter of matches alone."""
        variances, prior = [sight.cells.sigma_px**2 for sight in sights], self.knowledge.prior(self.names)
        return NetworkProblem(sights, variances, prior, self.free(network))

    def labelled_anew(self) -> "Grown":
        """With labels of planes that were met later."""
        matches = {pair: self._labels(pair) for pair in self.labelled}
        again = replace(self, labelled={}, sights=())
        for pair, pair_matches in matches.items():
            again = again._with(pair, pair_matches)
        return again

    def _known_points(self, pair: PairName) -> tuple[Floats, Floats]:
        """Of a pair with a placed device: points (N, 3), and the other device's pixels (N, 2)."""
        new = 0 if pair[0] not in self.names else 1
        known, matches = pair[1 - new], self._labels(pair)
        device = self.network.devices[self.names.index(known)]
        pixels = pixels_of(matches, 0), pixels_of(matches, 1)
        points, new_pixels = [], []
        for label, plane in enumerate(self.network.planes):
            own = evenly(matches.labels == label, _SAMPLE)
            if len(own) >= _LEAST_ON_PLANE:
                points.append(points_on(pixels[1 - new][own], device, plane))
                new_pixels.append(pixels[new][own])
        if len(points) < 2:
            devices = dict(zip(self.names, self.network.devices, strict=True))
            loose, at = self.overlaps.known_points(devices, known, pair[new], self.labelled)
            some = evenly(np.ones(len(loose), np.bool_), _SAMPLE)
            points.append(loose[some])
            new_pixels.append(at[some])
        return np.concatenate(points), np.concatenate(new_pixels)

    def _labels(self, pair: PairName) -> Matches:
        """Its matches, with what others tell of those without a label."""
        matches = self.labelled.get(pair, replace(self.captures[pair], face=None))
        label = np.full(len(matches), NO_FACE, np.int32) if matches.face is None else matches.face.copy()
        for role, name in enumerate(pair):
            sharing = [
                pair_matches
                for labelled_pair, pair_matches in self.labelled.items()
                if labelled_pair != pair and labelled_pair[role] == name
            ]
            if not sharing or not (label == NO_FACE).any():
                continue
            raster, unlabelled = self.overlaps.rasters[name], np.flatnonzero(label == NO_FACE)
            labels_of_pixels = label_map(
                raster, [(pixels_of(pair_matches, role), pair_matches.labels) for pair_matches in sharing]
            )
            label[unlabelled] = read(raster, labels_of_pixels, pixels_of(matches, role)[unlabelled])
        return matches.with_faces(label)

    def _with_device(self, pair: PairName, new: str, device: Device) -> "Grown":
        """With the device of a pair that was not placed before."""
        network = replace(self.network, devices=(*self.network.devices, self.knowledge.held(new, device)))
        more = replace(self, names=(*self.names, new), network=network)._with_pair(pair)
        alone = np.zeros(more.network.size, np.bool_)
        alone[more.network.device_columns(len(self.names))] = True
        return more._settled(alone & more.free(more.network))._settled(more.free(more.network))

    def _with_pair(self, pair: PairName) -> "Grown":
        """Of two placed devices, with labels as others tell them, and with planes that no other pair has seen."""
        matches = self._labels(pair)
        label, own = matches.labels.copy(), self.captures[pair].face
        planes = list(self.network.planes)
        devices = [self.network.devices[self.names.index(name)] for name in pair]
        for number in np.unique(own[own >= 0]).tolist() if own is not None else ():
            on, new = own == number, (own == number) & (label == NO_FACE)
            label_counts = np.bincount(label[on & ~new], minlength=1)
            if label_counts.sum() >= _LEAST_ON_PLANE:
                if label_counts.max() > _NEARLY_ALL * label_counts.sum():
                    label[new] = label_counts.argmax()
                continue
            if np.count_nonzero(new) < _LEAST_ON_PLANE:
                continue
            some = matches[evenly(new, _SAMPLE)]
            points = triangulated(devices[0], devices[1], some.camera_px, some.projector_px)
            points = points[np.isfinite(points).all(axis=1)]
            candidate = Plane.through(points, np.ones(len(points)), devices[0].pose.translation)
            if not _in_front(candidate, devices[0], devices[1], some.camera_px):
                continue
            same = [
                k for k, plane in enumerate(planes) if _alike(plane, candidate, points, devices[0].pose.translation)
            ]
            label[new] = same[0] if same else len(planes)
            planes += () if same else (candidate,)
        network = replace(self.network, planes=tuple(planes))
        return replace(self, network=network)._with(pair, matches.with_faces(label))

    def _with(self, pair: PairName, matches: Matches) -> "Grown":
        count = np.bincount(matches.labels[matches.labels >= 0], minlength=len(self.network.planes))
        labels = np.flatnonzero(count >= _LEAST_ON_PLANE).tolist()
        camera, projector = (self.names.index(name) for name in pair)
        cells = into_cells(matches, labels) if labels else None
        own = [
            PlaneObservation(len(self.labelled), camera, projector, label, cells[cells.plane == label])
            for label in labels
            if cells is not None
        ]
        return replace(self, labelled={**self.labelled, pair: matches}, sights=(*self.sights, *own))

    def _settled(self, free: Bools) -> "Grown":
        network = self.network
        for _ in range(_ROUNDS):
            problem = replace(self.problem(network, self.sights), free=free, joints=self.joints(network))
            network = problem.minimise(network, tolerance=ROUGH).state
            if not problem.joints:
                break
        return replace(self, network=network)


def _in_front(plane: Plane, camera: Device, projector: Device, camera_px: Floats) -> bool:
    """Whether nearly all of what a camera sees of a plane is before it and before a projector."""
    points = points_on(camera_px, camera, plane)
    ahead = [device.pose.undo(points)[:, 2] > 0 for device in (camera, projector)]
    return bool(np.mean(np.logical_and(*ahead)) > _NEARLY_ALL)


def _alike(plane: Plane, candidate: Plane, points: Floats, eye: Floats) -> bool:
    """Whether a plane that was found through points (N, 3) may be one that is known; wrong ties are found later."""
    off = np.abs(plane.heights(points)) / np.linalg.norm(points - eye, axis=1)
    return bool(abs(plane.normal @ candidate.normal) > _PARALLEL and np.median(off) < _ON_PLANE)
