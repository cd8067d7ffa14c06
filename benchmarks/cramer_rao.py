"""The Cramér–Rao bound of a synthetic capture."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.boards import INTRINSIC_COLUMNS, BoardView
from calib.boards import State as BoardState
from calib.boards.likelihood import BoardVariances, board_problem, device_prior
from calib.boards.parameters import PlacedBoard, device_of
from calib.estimation import Cells, Problem, into_cells
from calib.geometry import Matches, Plane
from calib.networks import Device, Network, PlaneObservation
from calib.networks.prior import NetworkKnowledge
from calib.numerics import Floats, covariance_of
from calib.refinement import CAMERA, PROJECTOR, CornerProblem, Knowledge, PlacedCorner, State, predict
from calib.refinement import device_of as rig_device_of
from calib.rooms import Patch, Room, RoomPrior
from calib.self_calibration import anywhere
from calib.synthetic import SyntheticBoards, SyntheticCapture, SyntheticNetwork, SyntheticPhotos

_SAMPLE = 3000
_LEAST_ON_PLANE = 100  # matches, as in an estimate


def bound(captures: list[SyntheticCapture], knowledge: Knowledge, noise_px: float) -> np.ndarray:
    """Relative sigmas of (f_c, f_p, x_p, y_p), (4,), as of `bound_covariance`."""
    return np.sqrt(np.diag(bound_covariance(captures, knowledge, noise_px)))


def bound_covariance(captures: list[SyntheticCapture], knowledge: Knowledge, noise_px: float) -> np.ndarray:
    """Relative covariance of (f_c, f_p, x_p, y_p), (4, 4), at the truth, each capture with its own corner.

    Lens terms that are zero in truth are fixed.
    """
    truth = captures[0].calibration
    state = State(
        rig_device_of(truth.camera),
        rig_device_of(truth.projector),
        truth.pose.in_baselines,
        np.zeros((len(captures), 3)),
        tuple(
            PlacedCorner(capture.corner.legs, capture.corner.vertex / truth.baseline, i)
            for i, capture in enumerate(captures)
        ),
    )
    prior = knowledge.prior(state)
    for device, columns in ((state.camera, CAMERA), (state.projector, PROJECTOR)):
        for column in np.flatnonzero(device[3:] == 0) + 3:
            prior = prior.knowing([columns.start + int(column)])
    cells, variances = [], []
    for i, capture in enumerate(captures):
        matches = capture.matches[capture.matches.face >= 0]
        sample = matches[:: max(1, len(matches) // _SAMPLE)]
        exact, _, _ = predict(state, sample.camera_px, sample.face, i)
        cells.append(_as_cells(replace(sample, projector_px=exact)))
        variances.append(np.full(len(sample), noise_px**2 * len(sample) / len(matches)))
    fit = CornerProblem.of(cells, prior, variances).evaluate(state)
    four = [CAMERA.start, *range(PROJECTOR.start, PROJECTOR.start + 3)]
    relative = 1 / np.array([1.0, 1.0, *truth.projector.principal_point_px])  # focals are logarithms
    return covariance_of(fit.information, prior.free)[np.ix_(four, four)] * np.outer(relative, relative)


def _as_cells(matches: Matches) -> Cells:
    one = np.ones(len(matches))
    return Cells(matches.camera_px, matches.projector_px, matches.face, one, one, 1.0, 0.0)


def bound_of_photos(
    photos: SyntheticPhotos, squareness_deg: float, first_noise_px: float, second_noise_px: float
) -> np.ndarray:
    """Sigmas of (f, x_0, y_0), (3,), in pixels from the first pair of photos, at the truth.

    Lens terms that are zero in truth are fixed. Noise in the first photo moves the prediction for the second by its
    derivative D, so that a match's residual has the covariance σ₂² I + σ₁² D Dᵀ.
    """
    matches, truth = photos.pairs[0]
    camera = rig_device_of(truth.camera)
    corner = PlacedCorner(photos.corner.legs, photos.corner.vertex)
    state = State(camera, camera, truth.pose, np.zeros((1, 3)), (corner,), one_camera=True)
    point = anywhere((truth.camera.width, truth.camera.height))
    size = truth.camera.width, truth.camera.height
    prior = Knowledge(size, size, point.px, point.sigma_px, squareness_deg, one_camera=True).prior(state)
    if camera[3] == 0:
        prior = prior.knowing([CAMERA.start + 3])
    step_px = 1e-3
    pixels, face = matches.camera_px, matches.face
    at, jacobian, _ = predict(state, pixels, face)
    shifted = [predict(state, pixels + step_px * axis, face)[0] for axis in np.eye(2)]
    slope = np.stack([(each - at) / step_px for each in shifted], axis=2)
    covariance = second_noise_px**2 * np.eye(2) + first_noise_px**2 * slope @ slope.transpose(0, 2, 1)
    weighted = np.linalg.solve(covariance, jacobian)
    information = np.diag(prior.root_precision**2) + np.einsum("nia,nib->ab", jacobian, weighted)
    sigma = np.sqrt(np.diag(covariance_of(information, prior.free)))[CAMERA][:3]
    return sigma * np.array([camera[0], 1.0, 1.0])


def bound_of_boards(boards: SyntheticBoards, views: list[BoardView]) -> np.ndarray:
    """Sigmas of f_x, x_0, y_0 of camera and projector, (6,), in pixels, at the truth.

    Lens terms that are zero in truth are fixed, as is a board's bend; pixels are square. `views`: the matches of the
    same boards as cells, with the sigmas of the noise.
    """
    rig, options = boards.calibration, boards.options
    bend = np.append(boards.bend, np.zeros(4))
    placed = tuple(PlacedBoard(pose) for pose in boards.poses)
    state = BoardState(device_of(rig.camera), device_of(rig.projector), rig.pose, bend, boards.reach, placed)
    prior = device_prior(rig.camera.size, rig.projector.size, 3 if bend.any() else 0)
    zero = np.flatnonzero(state.additive()[:18] == 0)
    prior = prior.knowing(np.concatenate([zero, [1, 10]]))
    per_match = [options.match_px**2 * (view.cells.sigma_px / view.cells.noise_px) ** 2 for view in views]
    levels = BoardVariances(np.full(len(views), options.corner_px**2), tuple(per_match))
    problem = board_problem(views, prior, levels)
    sigma = np.sqrt(np.diag(problem.covariance(problem.evaluate(state))))[INTRINSIC_COLUMNS]
    return sigma * np.array([rig.camera.focal_px[0], 1, 1, rig.projector.focal_px[0], 1, 1])


def bound_of_room(truth: Room, patches: Sequence[Patch], prior: RoomPrior, noise_px: float) -> np.ndarray:
    """Covariance (size, size) of a room's columns, at the truth.

    `patches`: of the same stations, with the sigmas of the noise; `prior`: starts at the truth.
    """
    exact = [replace(patch, cells=replace(patch.cells, projector_px=patch.predict(truth)[0])) for patch in patches]
    variances = [noise_px**2 * (patch.cells.sigma_px / patch.cells.noise_px) ** 2 for patch in patches]
    seen = np.isin(np.arange(len(truth.planes)), [patch.plane for patch in patches])
    problem = Problem(exact, variances, prior, prior.free(seen))
    return problem.covariance(problem.evaluate(truth))


def bound_of_network(made: SyntheticNetwork, names: Sequence[str], noise_px: float) -> Floats:
    """Sigmas (devices,) of log f of the devices `names`, at the truth, by what all pairs see of flat planes.

    The frame is that of the first device; nothing is known of devices and walls but what an estimate assumes of any.
    """
    frame = made.poses[names[0]]
    unit = (frame.inverse() @ made.poses[names[1]]).distance
    poses = [(frame.inverse() @ made.poses[name]).scaled(1 / unit) for name in names]
    devices = [
        Device(rig_device_of(made.devices[name]), pose, made.devices[name].size)
        for name, pose in zip(names, poses, strict=True)
    ]
    normals, offsets = made.planes
    planes = zip(normals @ frame.rotation, (offsets - normals @ frame.translation) / unit, strict=True)
    truth = Network(tuple(devices), tuple(Plane(normal, float(offset)) for normal, offset in planes))
    sights, variances = [], []
    for i, ((camera, projector), matches) in enumerate(made.captures.items()):
        labels = np.flatnonzero(np.bincount(matches.labels) >= _LEAST_ON_PLANE).tolist()
        cells = into_cells(matches, labels)
        for label in labels:
            own = cells[cells.plane == label]
            sight = PlaneObservation(i, names.index(camera), names.index(projector), label, own)
            sights.append(replace(sight, cells=replace(own, projector_px=sight.predict(truth)[0])))
            variances.append(noise_px**2 * (own.sigma_px / own.noise_px) ** 2)
    sizes = {name: device.size for name, device in made.devices.items()}
    knowledge = NetworkKnowledge(sizes, frozenset(camera for camera, _ in made.captures))
    seen = {sight.plane for sight in sights}
    free = knowledge.free(truth, names)
    for plane in range(len(truth.planes)):
        free[truth.plane_columns(plane)] = plane in seen
    focals = [truth.device_columns(number).start for number in range(len(names))]
    problem = Problem(sights, variances, knowledge.prior(tuple(names)), free)
    sigmas: Floats = np.sqrt(np.diag(problem.covariance(problem.evaluate(truth))))[focals]
    return sigmas
