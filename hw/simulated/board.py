"""A printed chessboard held before the rig: slightly bent, in a pose that is drawn from the seed.

Written on its own, not on top of the calibration's model of a board. It hides what is behind it, and gets the ambient
and indirect light that this had; it throws no shadow on the room, and sends no light back to it.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from calib.numerics import Bools, Floats, Ints
from hw.errors import DeviceError
from hw.settings import BoardSettings
from hw.simulated.device import PlacedDevice

_WHITE, _BLACK = 0.85, 0.06
_RIM = 1.0  # white squares around the checks
_STEPS = 5
_ATTEMPTS = 4000
_STREAM = 103  # apart from all other random numbers
_TILT_DEG = (10.0, 40.0)
_SHARE = (0.5, 1.0)  # of the projected picture's height that the board's longer side has


@dataclass(frozen=True)
class Sheet:
    """A board of `columns` × `rows` inner corners; `rotation` (3, 3) from its axes, `middle` (3,), in the world.

    A point (u, v) of it, in metres from its middle, is `reach` (c₀ a² + c₁ ab + c₂ b²) off its plane, with
    (a, b) = (u, v) / `reach` and c the `bend` (3,).
    """

    columns: int
    rows: int
    square_m: float
    bend: Floats
    rotation: Floats
    middle: Floats

    @property
    def half(self) -> Floats:
        """Half its size along u and v, with the rim, in metres."""
        return self.square_m * (np.array([self.columns + 1, self.rows + 1]) / 2 + _RIM)

    @property
    def reach(self) -> float:
        """Half the longer side of the checks."""
        return self.square_m * (max(self.columns, self.rows) + 1) / 2

    @property
    def corners(self) -> Floats:
        """The inner corners (N, 2), row by row, in metres from the middle."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        counts = np.array([self.columns - 1, self.rows - 1])
        return (np.stack([column.ravel(), row.ravel()], axis=1) - counts / 2) * self.square_m

    def points(self, uv: Floats) -> Floats:
        """Points (3, n) of the world at (u, v), (2, n)."""
        heights, _ = self._surface(uv)
        points: Floats = self.rotation @ np.vstack([uv, heights]) + self.middle[:, None]
        return points

    def meet(self, origin: Floats, directions: Floats) -> tuple[Floats, Bools]:
        """Where rays (3, n) from an origin (3,) meet it: (u, v), (2, n), and whether they do at all, (n,)."""
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
        """Unit normals (3, n) towards negative z of the board: to where it is read from."""
        _, slopes = self._surface(uv)
        normals = self.rotation @ np.vstack([slopes, -np.ones(slopes.shape[1])])
        unit: Floats = normals / np.linalg.norm(normals, axis=0)
        return unit

    def albedo(self, uv: Floats) -> Floats:
        """Printed black and white, (n,)."""
        counts = np.array([[self.columns + 1], [self.rows + 1]])
        cell = np.floor(uv / self.square_m + counts / 2)
        inside = np.all((cell >= 0) & (cell < counts), axis=0)
        albedo: Floats = np.where(inside & (cell.sum(axis=0) % 2 == 0), _BLACK, _WHITE)
        return albedo

    def _surface(self, uv: Floats) -> tuple[Floats, Floats]:
        """Heights (n,) and slopes (2, n)."""
        a, b = uv / self.reach
        c0, c1, c2 = self.bend
        heights = self.reach * (c0 * a * a + c1 * a * b + c2 * b * b)
        return heights, np.stack([2 * c0 * a + c1 * b, c1 * a + 2 * c2 * b])


def draw_board(settings: BoardSettings, seed: int, camera: PlacedDevice, projector: PlacedDevice) -> Sheet:
    """The board at its pose number `settings.pose`, wholly in both pictures. Raises DeviceError if there is none."""
    shape = np.random.default_rng([seed, _STREAM])
    bend = shape.normal(0.0, settings.bend, 3)
    rng = np.random.default_rng([seed, _STREAM, settings.pose])
    length = settings.square_m * (max(settings.columns, settings.rows) + 1)
    optics = projector.optics
    for _ in range(_ATTEMPTS):
        distance = optics.focal_px * length / (optics.height * rng.uniform(*_SHARE))
        pixel = rng.uniform(0.25, 0.75, 2) * (optics.width, optics.height)
        middle = projector.centre + distance * projector.rays(pixel[:, None])[:, 0]
        towards = rng.uniform(0, 2 * np.pi)
        tilt = np.radians(rng.uniform(*_TILT_DEG)) * np.array([np.cos(towards), np.sin(towards), 0.0])
        turn = Rotation.from_rotvec(tilt) * Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)])
        board = Sheet(
            *(settings.columns, settings.rows, settings.square_m, bend),
            camera.rotation.T @ np.asarray(turn.as_matrix(), np.float64),
            middle,
        )
        if _whole(board, camera) and _whole(board, projector):
            return board
    raise DeviceError(
        f"the simulated rig of seed {seed} sees no board of {settings.columns} × {settings.rows} corners with squares "
        f"of {settings.square_m:g} m whole with both devices; use another seed or another board"
    )


def _whole(board: Sheet, device: PlacedDevice) -> bool:
    """Whether a device sees all of the checks from the front."""
    reach = board.half - _RIM / 2 * board.square_m
    around = np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]]) * reach[:, None]
    points = board.points(around)
    pixels, depths = device.project(points)
    facing = np.sum(board.normals(around) * (device.centre[:, None] - points), axis=0)
    return bool(np.all(depths > 0) and device.optics.sees(pixels).all() and np.all(facing > 0))


def before(
    room: tuple[sparse.csr_array, sparse.csr_array], pixels: Ints, gain: Floats, direct: sparse.csr_array, samples: int
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Footprints (direct, indirect) of camera pixels in a room, with a board before it.

    `pixels` (n,): which pixel each sample that meets the board belongs to, of so many `samples` in each; `gain` (n,):
    from irradiance to brightness; `direct`: the board's own.
    """
    count = room[0].shape[0]
    free = 1 - np.bincount(pixels, minlength=count) / samples
    of_board = np.bincount(pixels, gain, count) / samples
    of_room = np.maximum(np.asarray(room[1].sum(axis=1)).ravel(), 1e-12)
    kept = sparse.diags_array(free.astype(np.float32))
    light = sparse.diags_array((free + of_board / of_room).astype(np.float32))
    return sparse.csr_array(kept @ room[0] + direct), sparse.csr_array(light @ room[1])
