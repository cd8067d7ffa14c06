"""Parameters of a rig and boards, predicted corners and matches, and their exact derivatives.

A board's point (a, b), in lengths from its middle, is at (a, b, h(a, b)), with h its bend. The camera sees its corners.
The ray of a camera pixel intersects the board, and the intersection is projected into the projector. So every match on
the board is predicted, with or without a corner.

Columns of every step, gradient and Hessian: of the camera log f_x, log (f_y / f_x), x_0, y_0, k1, k2, p1, p2, k3; the
same of the projector; rotation (3), direction (2) and logarithm of the length of their relative pose; the bend (7);
then for each view the board's rotation (3), its position (3, relative to its distance), and the deviation of its bend
(3), because a board that is held or leans is not quite rigid.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.geometry import PER_POSE, Intrinsics, Pose, cross, cross_matrix
from calib.geometry import radial_distortion as lens
from calib.numerics import Bools, Floats, Ints
from calib.refinement import moved_device

PER_DEVICE, PER_BEND = 9, 7
PER_FLEX = 3
PER_VIEW = PER_POSE + PER_FLEX
CAMERA, PROJECTOR = slice(0, 9), slice(9, 18)
ROTATION, DIRECTION, LENGTH = slice(18, 21), slice(21, 23), 23
POSE, BEND = slice(18, 24), slice(24, 31)
SHARED = 31
FOCAL, ASPECT, CENTRE, LENS = 0, 1, slice(2, 4), slice(4, 9)  # columns of a device
# Columns of log focal length and principal point of camera and projector.
INTRINSIC_COLUMNS = [0, 2, 3, 9, 11, 12]

_MEETING_STEPS, _MET = 4, 1e-9  # Newton's next step would be that squared
_SPARE = 3.0  # in units of the board's reach: farther out, a bend has no meaning


@dataclass(frozen=True)
class PlacedBoard:
    """A board in front of the camera."""

    pose: Pose
    """From the board's axes, whose origin is its middle, to the camera's frame."""
    flex: Floats = field(default_factory=lambda: np.zeros(PER_FLEX))
    """(3,): deviation of the first terms of its bend."""

    def moved(self, step: Floats) -> "PlacedBoard":
        """After a step (9,)."""
        return PlacedBoard(self.pose.retract(step[:PER_POSE], self.pose.distance), self.flex + step[PER_POSE:])


@dataclass(frozen=True)
class State:
    """Both devices, their relative pose, and the board in every view."""

    camera: Floats
    """(9,): f_x, f_y / f_x, x_0, y_0, k1, k2, p1, p2, k3."""
    projector: Floats
    """(9,): the same."""
    pose: Pose
    """X_projector = R X_camera + t."""
    bend: Floats
    """(7,): coefficients of a², ab, b², a³, a²b, ab², b³, with a, b and the height in units of `reach`."""
    reach: float
    """Half the board's longer side."""
    boards: tuple[PlacedBoard, ...]
    """In each view."""

    @property
    def size(self) -> int:
        """Number of columns."""
        return SHARED + PER_VIEW * len(self.boards)

    def board_columns(self, view: int) -> slice:
        """Columns of a view's board: its pose and flex."""
        return slice(SHARED + PER_VIEW * view, SHARED + PER_VIEW * (view + 1))

    def bend_of(self, view: int) -> Floats:
        """The board's bend in a view, (7,)."""
        bend: Floats = self.bend.copy()
        bend[:PER_FLEX] += self.boards[view].flex
        return bend

    def columns(self, view: int) -> Ints:
        """The columns that a view depends on, in the order of its Jacobians: what is shared, and its pose."""
        own = self.board_columns(view)
        return np.concatenate([np.arange(SHARED, dtype=np.int32), np.arange(own.start, own.stop, dtype=np.int32)])

    def moved(self, step: Floats) -> "State":
        """The state after a step (size,)."""
        return replace(
            self,
            camera=moved_device(self.camera, step[CAMERA]),
            projector=moved_device(self.projector, step[PROJECTOR]),
            pose=self.pose.retract_baseline(step[POSE]),
            bend=self.bend + step[BEND],
            boards=tuple(board.moved(step[self.board_columns(i)]) for i, board in enumerate(self.boards)),
        )

    def additive(self) -> Floats:
        """The columns that may have a prior, as numbers that a step adds to, (SHARED,); zero for the pose."""
        values = np.zeros(SHARED)
        for columns, device in ((CAMERA, self.camera), (PROJECTOR, self.projector)):
            values[columns] = device
            values[columns][:2] = np.log(device[:2])
        values[BEND] = self.bend
        return values

    def of_views(self, chosen: Sequence[int]) -> "State":
        """The same with some of the boards."""
        return replace(self, boards=tuple(self.boards[i] for i in chosen))

    def normal(self, view: int) -> Floats:
        """The board's unit normal in the camera's frame, (3,)."""
        return self.boards[view].pose.rotation[:, 2]


def flex_columns(views: int) -> Ints:
    """Columns of all views' flex, (V, 3)."""
    starts = SHARED + PER_VIEW * np.arange(views) + PER_POSE
    return (starts[:, None] + np.arange(PER_FLEX)).astype(np.int32)


def device_of(intrinsics: Intrinsics) -> Floats:
    """(9,) of a device."""
    (fx, fy), centre = intrinsics.focal_px, intrinsics.principal_point_px
    return np.array([fx, fy / fx, *centre, *intrinsics.distortion])


def surface(state: State, points: Floats, view: int) -> tuple[Floats, Floats, Floats]:
    """Heights (N,) of a board's points (N, 2), their slopes (N, 2) and derivatives by the bend (N, 7)."""
    bend = state.bend_of(view)
    rows = np.empty((9, len(points)))  # a, b, a², ab, b², a³, a²b, ab², b³
    rows[:2] = points.T / state.reach
    a, b = rows[:2]
    rows[2:4], rows[4] = a * rows[:2], b * b
    rows[5:8], rows[8] = a * rows[2:5], b * rows[4]
    aa, ab, bb, aaa, aab, abb, bbb = bend
    slopes = np.array([[2 * aa, ab, 3 * aaa, 2 * aab, abb], [ab, 2 * bb, aab, 2 * abb, 3 * bbb]]) @ rows[:5]
    return state.reach * (bend @ rows[2:]), slopes.T, state.reach * rows[2:].T


def predict_corners(state: State, points: Floats, view: int) -> tuple[Floats, Floats, Floats]:
    """Where a board's points (N, 2) are in the camera: pixels (N, 2), Jacobian (N, 2, 40), depths (N,)."""
    heights, _, by_bend = surface(state, points, view)
    board = state.boards[view].pose
    turned = _turned(board, points, heights)
    in_camera = turned + board.translation
    pixels, by_point, by_device = lens.project(state.camera, in_camera)
    jacobian = _by_board(board, by_point, turned, by_bend)
    jacobian[:, :, CAMERA] = by_device
    return pixels, jacobian, in_camera[:, 2]


def predict_matches(state: State, camera_px: Floats, view: int) -> tuple[Floats, Floats, Floats]:
    """Where camera pixels (N, 2) on a board fall in the projector, (N, 2); Jacobian (N, 2, 40); depths (N, 2)."""
    rays, rays_by_camera = rays_of(state.camera, camera_px), lens.unproject(state.camera, camera_px)[1][:, :2]
    met = meet(state, rays, view)
    heights, slopes, by_bend = surface(state, met, view)
    board, pose = state.boards[view].pose, state.pose
    on_board = _turned(board, met, heights)
    in_camera = on_board + board.translation
    turned = pose.rotate(in_camera)
    moved = turned + pose.translation
    pixels, by_moved, by_device = lens.project(state.projector, moved)
    # The point stays on its ray while the rest moves, d(X/Z) = dr, because it also moves along the board.
    along = board.rotation[:, :2] + slopes[:, None, :] * board.rotation[:, 2:]  # (N, 3, 2)
    by_seen, off_ray = by_moved @ pose.rotation, _by_point(in_camera)
    by_ray = _solved((off_ray @ along).transpose(0, 2, 1), (by_seen @ along).transpose(0, 2, 1)).transpose(0, 2, 1)
    jacobian = _by_board(board, by_seen - by_ray @ off_ray, on_board, by_bend)
    jacobian[:, :, CAMERA] = by_ray @ rays_by_camera
    jacobian[:, :, ROTATION] = cross(turned[:, None], by_moved)
    jacobian[:, :, DIRECTION] = by_moved @ pose.by_direction
    jacobian[:, :, LENGTH] = by_moved @ pose.translation
    jacobian[:, :, PROJECTOR] = by_device
    return pixels, jacobian, np.stack([in_camera[:, 2], moved[:, 2]], axis=1)


def meet(state: State, rays: Floats, view: int) -> Floats:
    """Where rays (N, 2), at z = 1 in the camera's frame, meet a board: its points (N, 2), by Newton's method."""
    board = state.boards[view].pose
    directions = board.inverse().rotate(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
    start = board.undo(np.zeros(3))  # the camera's centre in the board's axes
    points: Floats = start[:2] - directions[:, :2] * (start[2] / directions[:, 2])[:, None]
    if not state.bend_of(view).any():
        return points
    for _ in range(_MEETING_STEPS):
        within = np.clip(points, -_SPARE * state.reach, _SPARE * state.reach)
        heights, slopes, _ = surface(state, within, view)
        # On the tangent plane at the point: z − h − s · (p − point) = 0 along start + t direction.
        fixed = heights - np.sum(slopes * within, axis=1)
        falling = directions[:, 2] - np.sum(slopes * directions[:, :2], axis=1)
        t = (fixed + slopes @ start[:2] - start[2]) / falling
        before, points = points, start[:2] + t[:, None] * directions[:, :2]
        if np.abs(points - before).max(initial=0.0) < _MET * state.reach:
            break
    return points


def rays_of(device: Floats, pixels: Floats) -> Floats:
    """Ideal image points (N, 2) of a device's pixels, in focals."""
    f, aspect, x0, y0, k1, k2, p1, p2, k3 = (float(value) for value in device)
    return lens.undistort(pixels, (k1, k2, p1, p2, k3), (f, f * aspect, x0, y0))


def points_along(device: Floats, pixels: Floats, depth: float) -> Floats:
    """Points (N, 3) at these depths on the rays of a device's pixels (N, 2), in its frame; NaN without a ray."""
    return depth * np.concatenate([rays_of(device, pixels), np.ones((len(pixels), 1))], axis=1)


def is_seen(device: Floats, points: Floats, size: tuple[int, int]) -> Bools:
    """Whether points (N, 3) in a device's frame are in its picture."""
    pixels = np.full((len(points), 2), np.nan)
    ahead = points[:, 2] > 0
    pixels[ahead] = lens.project(device, points[ahead])[0]
    # A lens model that folds back maps points far outside into the picture; their rays are invalid.
    rays = rays_of(device, pixels)
    same = np.linalg.norm(rays - points[:, :2] / points[:, 2:], axis=1) < 1e-6
    visible: Bools = same & np.all((pixels >= 0) & (pixels <= np.array(size) - 1), axis=1)
    return visible


def project_rays(device: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the pixels of rays (N, 2) by a rotation of the device (N, 2, 3) and by its columns (N, 2, 9)."""
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    _, by_point, by_device = lens.project(device, points)
    return -by_point @ cross_matrix(points), by_device


def _solved(matrices: Floats, values: Floats) -> Floats:
    """Solutions (N, 2, K) of 2 × 2 systems (N, 2, 2), by Cramer's rule: several times as fast as LAPACK, one by one."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)[:, :, :, None]
    x, y = values[:, 0], values[:, 1]
    solved: Floats = np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
    return solved


def _by_point(points: Floats) -> Floats:
    """Derivatives (N, 2, 3) of (X/Z, Y/Z)."""
    x, y, z = points.T
    by_point = np.zeros((len(points), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1 / z
    by_point[:, 0, 2], by_point[:, 1, 2] = -x / z**2, -y / z**2
    return by_point


def _turned(board: Pose, points: Floats, heights: Floats) -> Floats:
    """A board's points (N, 2) in the camera's axes, from its middle, (N, 3)."""
    return board.rotate(np.concatenate([points, heights[:, None]], axis=1))


def _by_board(board: Pose, by_point: Floats, turned: Floats, by_bend: Floats) -> Floats:
    """Derivatives (N, 2, 40) by a board's columns, of pixels whose derivatives by its points are `by_point` (N, 2, 3);
    zero for the devices' columns.
    """
    by_columns = np.zeros((len(by_point), 2, SHARED + PER_VIEW))
    by_columns[:, :, BEND] = (by_point @ board.rotation[:, 2:]) * by_bend[:, None, :]
    by_columns[:, :, SHARED : SHARED + 3] = cross(turned[:, None], by_point)
    by_columns[:, :, SHARED + 3 : SHARED + PER_POSE] = board.distance * by_point
    by_columns[:, :, SHARED + PER_POSE :] = by_columns[:, :, BEND.start : BEND.start + PER_FLEX]
    return by_columns
