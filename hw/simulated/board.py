"""A printed board: slightly bent and held in front of the rig, in a pose drawn from the seed; or lying on the floor.

It does not use the calibration's model of a board, so that an error in either shows. The board hides what is behind it.
It receives the ambient and indirect light of the surfaces that it hides. It casts no shadow on the room, and reflects
no light back to it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from calib.numerics import Bools, Floats, Image, Ints
from hw.errors import DeviceError
from hw.settings import BoardSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.scene import Label, Scene

_WHITE, _BLACK = 0.85, 0.06
_RIM, _CHARUCO_RIM = 1.0, 0.25  # white squares around what is printed
_STEPS = 5
_ATTEMPTS = 4000
_STREAM, _FLOOR_STREAM = 103, 104  # streams of random numbers that nothing else uses
_TILT_DEG = (10.0, 40.0)
_PAPER_M = 1e-4
_FLOOR_M = (0.1, 2.5)  # from either wall
_MODULES_PX = 100  # per square of a drawn ChArUco board; its marker has 70, seven modules of 10
_MARKER = 0.7
_SHARE = (0.5, 1.0)  # the board's longer side over the height of the projected picture


@dataclass(frozen=True)
class SimulatedBoard:
    """A board of `columns` × `rows` squares. `rotation` (3, 3) from its axes to the world, `middle` (3,) in the world.

    A point at (u, v) metres from the middle is off the board's plane by `reach` (c₀ a² + c₁ ab + c₂ b²), with
    (a, b) = (u, v) / `reach` and c the `bend` (3,). `printed` (H, W): the printed image; None for a chessboard.
    """

    columns: int
    rows: int
    square_m: float
    bend: Floats
    rotation: Floats
    middle: Floats
    printed: Image | None = None

    @property
    def half(self) -> Floats:
        """Half the size along u and v, with the rim, in metres, (2,)."""
        return self.square_m * (np.array([self.columns, self.rows]) / 2 + self.rim)

    @property
    def rim(self) -> float:
        """Width of the white rim, in squares."""
        return _RIM if self.printed is None else _CHARUCO_RIM

    @property
    def reach(self) -> float:
        """Half the longer side of the printed squares, in metres."""
        return self.square_m * max(self.columns, self.rows) / 2

    @property
    def corners(self) -> Floats:
        """The inner corners (N, 2), row by row, in metres from the middle."""
        column, row = np.meshgrid(np.arange(self.columns - 1), np.arange(self.rows - 1))
        counts = np.array([self.columns - 2, self.rows - 2])
        return (np.stack([column.ravel(), row.ravel()], axis=1) - counts / 2) * self.square_m

    def points(self, uv: Floats) -> Floats:
        """Board coordinates (u, v), (2, n), in metres → points (3, n) in the world."""
        heights, _ = self._surface(uv)
        return self.rotation @ np.vstack([uv, heights]) + self.middle[:, None]

    def intersect(self, origin: Floats, directions: Floats) -> tuple[Floats, Bools]:
        """Intersect rays (3, n) from an origin (3,) with the board.

        Returns (u, v), (2, n), and whether each ray hits the board, (n,).
        """
        local = self.rotation.T @ directions
        start = self.rotation.T @ (origin - self.middle)
        t = -start[2] / local[2]
        for _ in range(_STEPS):
            uv = start[:2, None] + t * local[:2]
            heights, slopes = self._surface(np.clip(uv, -3 * self.reach, 3 * self.reach))
            t -= (start[2] + t * local[2] - heights) / (local[2] - np.sum(slopes * local[:2], axis=0))
        uv = start[:2, None] + t * local[:2]
        hit: Bools = (t > 0) & np.all(np.abs(uv) <= self.half[:, None], axis=0)
        return uv, hit

    def normals(self, uv: Floats) -> Floats:
        """Unit normals (3, n) on the printed side, which faces negative z of the board."""
        _, slopes = self._surface(uv)
        normals = self.rotation @ np.vstack([slopes, -np.ones(slopes.shape[1])])
        unit: Floats = normals / np.linalg.norm(normals, axis=0)
        return unit

    def albedo(self, uv: Floats) -> Floats:
        """Albedo (n,) of the black and white print at (u, v), (2, n)."""
        counts = np.array([[self.columns], [self.rows]])
        place = uv / self.square_m + counts / 2
        cell = np.floor(place)
        inside = np.all((cell >= 0) & (cell < counts), axis=0)
        if self.printed is not None:
            column, row = np.floor(place * _MODULES_PX).astype(np.int64).clip(0, _MODULES_PX * counts - 1)
            return np.where(inside & (self.printed[row, column] == 0), _BLACK, _WHITE)
        return np.where(inside & (cell.sum(axis=0) % 2 == 0), _BLACK, _WHITE)

    def _surface(self, uv: Floats) -> tuple[Floats, Floats]:
        """Heights (n,) above the plane and slopes (2, n) at (u, v), (2, n)."""
        a, b = uv / self.reach
        c0, c1, c2 = self.bend
        heights = self.reach * (c0 * a * a + c1 * a * b + c2 * b * b)
        return heights, np.stack([2 * c0 * a + c1 * b, c1 * a + 2 * c2 * b])


def draw_board(
    settings: BoardSettings, seed: int, camera: PlacedDevice, projector: PlacedDevice, scene: Scene
) -> SimulatedBoard:
    """Draw the board in pose number `settings.pose`, completely inside both devices' views, or on the floor of a scene.

    Raises DeviceError if no such pose is found.
    """
    if settings.on_floor:
        board = _on_floor(settings, seed, camera, projector, scene)
    else:
        board = _held_up(settings, seed, camera, projector)
    if board is None:
        raise DeviceError(
            f"the simulated rig of seed {seed} sees no {settings.kind} of {settings.columns} × {settings.rows} with "
            f"squares of {settings.square_m:g} m whole with both devices; use another seed or another board"
        )
    return board


def _unplaced(settings: BoardSettings, bend: Floats) -> SimulatedBoard:
    columns, rows = settings.columns, settings.rows
    printed = None
    if settings.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
        drawn = cv2.aruco.CharucoBoard((columns, rows), 1.0, _MARKER, dictionary)
        printed = np.asarray(drawn.generateImage((_MODULES_PX * columns, _MODULES_PX * rows)), np.uint8)
    else:
        columns, rows = columns + 1, rows + 1
    return SimulatedBoard(columns, rows, settings.square_m, bend, np.eye(3), np.zeros(3), printed)


def _on_floor(
    settings: BoardSettings, seed: int, camera: PlacedDevice, projector: PlacedDevice, scene: Scene
) -> SimulatedBoard | None:
    """Place the board on the floor where neither view of it is occluded. Views that leave a place free share that
    place.
    """
    rng = np.random.default_rng([seed, _FLOOR_STREAM])
    sheet = _unplaced(settings, np.zeros(3))
    for _ in range(_ATTEMPTS):
        x, y = rng.uniform(*_FLOOR_M, 2)
        heading = rng.uniform(-np.pi, np.pi)
        cosine, sine = np.cos(heading), np.sin(heading)
        # The printed side faces up, so the z axis points down.
        rotation = np.array([[cosine, sine, 0.0], [sine, -cosine, 0.0], [0.0, 0.0, -1.0]])
        board = replace(sheet, rotation=rotation, middle=np.array([x, y, _PAPER_M]))
        if all(_fully_visible(board, device) and _unoccluded(board, device, scene) for device in (camera, projector)):
            return board
    return None


def _unoccluded(board: SimulatedBoard, device: PlacedDevice, scene: Scene) -> bool:
    """Whether nothing occludes any part of a board on the floor from a device."""
    around = np.stack(np.meshgrid(*(np.linspace(-half, half, 9) for half in board.half))).reshape(2, -1)
    _, surface = scene.cast(device.centre[:, None], board.points(around) - device.centre[:, None])
    return bool(np.all(scene.labels[surface] == Label.FLOOR))


def _held_up(
    settings: BoardSettings, seed: int, camera: PlacedDevice, projector: PlacedDevice
) -> SimulatedBoard | None:
    shape = np.random.default_rng([seed, _STREAM])
    sheet = _unplaced(settings, shape.normal(0.0, settings.bend, 3))
    rng = np.random.default_rng([seed, _STREAM, settings.pose])
    length = 2 * sheet.reach
    optics = projector.optics
    for _ in range(_ATTEMPTS):
        distance = optics.focal_px * length / (optics.height * rng.uniform(*_SHARE))
        pixel = rng.uniform(0.25, 0.75, 2) * (optics.width, optics.height)
        middle = projector.centre + distance * projector.rays(pixel[:, None])[:, 0]
        towards = rng.uniform(0, 2 * np.pi)
        tilt = np.radians(rng.uniform(*_TILT_DEG)) * np.array([np.cos(towards), np.sin(towards), 0.0])
        turn = Rotation.from_rotvec(tilt) * Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)])
        rotation = camera.rotation.T @ np.asarray(turn.as_matrix(), np.float64)
        board = replace(sheet, rotation=rotation, middle=middle)
        if _fully_visible(board, camera) and _fully_visible(board, projector):
            return board
    return None


def _fully_visible(board: SimulatedBoard, device: PlacedDevice) -> bool:
    """Whether a device sees all printed squares from the front."""
    reach = board.half - board.rim / 2 * board.square_m
    around = np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]]) * reach[:, None]
    points = board.points(around)
    pixels, depths = device.project(points)
    facing = np.sum(board.normals(around) * (device.centre[:, None] - points), axis=0)
    return bool(np.all(depths > 0) and device.optics.sees(pixels).all() and np.all(facing > 0))


def with_board(
    room: tuple[sparse.csr_array, sparse.csr_array], pixels: Ints, gain: Floats, direct: sparse.csr_array, samples: int
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Footprints (direct, indirect) of camera pixels in a room with a board in front of it.

    `pixels` (n,): the pixel of each sample that hits the board; every pixel has `samples` samples. `gain` (n,): from
    irradiance to brightness. `direct`: the board's own direct footprint.
    """
    count = room[0].shape[0]
    free = 1 - np.bincount(pixels, minlength=count) / samples
    of_board = np.bincount(pixels, gain, count) / samples
    of_room = np.maximum(np.asarray(room[1].sum(axis=1)).ravel(), 1e-12)
    kept = sparse.diags_array(free.astype(np.float32))
    light = sparse.diags_array((free + of_board / of_room).astype(np.float32))
    return sparse.csr_array(kept @ room[0] + direct), sparse.csr_array(light @ room[1])
