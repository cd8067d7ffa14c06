"""A rig in front of a ball and a wall, in closed form: ground truth of each pixel, also while the ball moves."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from calib.geometry import Calibration, Intrinsics, Pose
from calib.numerics import Bools, Floats, Image
from hw.errors import FrameLostError
from hw.rig import Capabilities, Frame, Rig

CAMERA, PROJECTOR = (160, 128), (400, 300)
_MOST = 5000  # frames
_LEVELS, _NOISE = 200.0, (1.0, 0.02)  # of white; variance at level 0, and what each level adds
_WALL_M, _RADIUS_M, _BALL_M = 0.6, 0.08, (0.02, 0.0, 0.5)


def calibration(lens: float = 0.0, smaller: float = 1) -> Calibration:
    """Both devices side by side, converging; `lens`: radial term of both. The camera's image may be reduced."""
    angle = 0.2
    turned = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    distortion = (lens, 0.0, 0.0, 0.0, 0.0)
    focal, width, height = 220.0 / smaller, round(CAMERA[0] / smaller), round(CAMERA[1] / smaller)
    camera = Intrinsics(width, height, (focal, focal), (80.0 / smaller, 63.0 / smaller), distortion)
    projector = Intrinsics(*PROJECTOR, (560.0, 560.0), (205.0, 150.0), distortion)
    return Calibration(camera, projector, Pose(turned, np.array([-0.12, 0.005, 0.01])), "m")


@dataclass
class LiveBench:
    """`speed_m`: per frame. `late`: numbers of frames with a `share` of the previous picture; `lost`: of missing
    frames. Frames are numbered as they are taken. `bounce`: interreflection, as from another wall.
    """

    speed_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    late: frozenset[int] = frozenset()
    lost: frozenset[int] = frozenset()
    share: float = 1.0
    gamma: float = 1.0
    bounce: float = 0.0
    seed: int = 0
    taken: int = 0
    calibration: Calibration = field(default_factory=calibration)

    size = PROJECTOR  # as a projector
    highest_level = 255
    capabilities = Capabilities()

    def __post_init__(self) -> None:
        width, height = self.calibration.camera.size
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        self._rays = self.calibration.camera.unproject(np.stack([x, y], axis=-1))
        self._shown = self._before = np.zeros(PROJECTOR[::-1], np.uint8)
        self._rng = np.random.default_rng(self.seed)
        self._seen: tuple[int, tuple[Floats, Floats, Bools]] | None = None

    @property
    def rig(self) -> Rig:
        """The rig of both devices."""
        return Rig(self, _Camera(self), {"backend": "bench"})

    def show(self, image: Image) -> None:
        """Show a picture at once."""
        self._before, self._shown = self._shown, image

    def take(self) -> Frame:
        """Take a frame. Raises FrameLostError."""
        number, self.taken = self.taken, self.taken + 1
        assert number < _MOST, "nobody has ended this"
        if number in self.lost:
            raise FrameLostError("as was asked for")
        share = self.share if number in self.late else 0.0
        light = (1 - share) * (self._shown / 255.0) ** self.gamma + share * (self._before / 255.0) ** self.gamma
        pixel, shade, lit = self._scene(number)
        level = _LEVELS * shade * (0.02 + 0.98 * np.where(lit, _sampled(light, pixel), 0.0))
        if self.bounce:
            elsewhere = np.asarray(cv2.blur(light, (101, 101)), np.float64)[:, ::-1]
            level += _LEVELS * shade * self.bounce * np.where(lit, _sampled(elsewhere, pixel), 0.0)
        level += self._rng.standard_normal(level.shape) * np.sqrt(_NOISE[0] + _NOISE[1] * level)
        return Frame(np.clip(np.rint(level), 0, 255).astype(np.uint8), exposure_us=1000.0)

    def truth(self, frame: float) -> tuple[Floats, Floats]:
        """Ground truth of each pixel at the time of a frame: the projector pixel that lights it, (H, W, 2), NaN where
        none does; and the point (H, W, 3).
        """
        points, _ = self._points(frame)
        pixel, _, lit = self._lit(points)
        return np.where(lit[..., None], pixel, np.nan), points

    def on_ball(self, frame: float) -> Bools:
        """Mask of the pixels that see the ball, (H, W)."""
        return self._points(frame)[1]

    def _scene(self, number: int) -> tuple[Floats, Floats, Bools]:
        at = number if any(self.speed_m) else 0
        if self._seen is None or self._seen[0] != at:
            self._seen = at, self._lit(self._points(at)[0])
        return self._seen[1]

    def _points(self, frame: float) -> tuple[Floats, Bools]:
        centre = np.array(_BALL_M) + frame * np.array(self.speed_m)
        rays = self._rays
        a, b = np.sum(rays * rays, axis=-1), rays @ centre
        root = b * b - a * (centre @ centre - _RADIUS_M**2)
        ball = root > 0
        depth = np.where(ball, (b - np.sqrt(np.maximum(root, 0))) / a, _WALL_M)
        points: Floats = depth[..., None] * rays
        return points, ball

    def _lit(self, points: Floats) -> tuple[Floats, Floats, Bools]:
        to = self.calibration.pose @ points
        pixel = self.calibration.projector.project(to)
        width, height = PROJECTOR
        inside = (pixel[..., 0] > 0) & (pixel[..., 0] < width - 1) & (pixel[..., 1] > 0) & (pixel[..., 1] < height - 1)
        shade = 0.6 + 0.3 * np.cos(40 * points[..., 0]) * np.cos(40 * points[..., 1])
        return pixel, shade, inside


class _Camera:
    highest_level = 255
    capabilities = Capabilities()

    def __init__(self, bench: LiveBench) -> None:
        self._bench = bench
        self.size: tuple[int, int] = bench.calibration.camera.size

    def grab(self) -> Frame:
        return self._bench.take()


def _sampled(light: Floats, pixel: Floats) -> Floats:
    """Linear interpolation between projector pixels."""
    x, y = (np.clip(np.nan_to_num(pixel[..., n]), 0, PROJECTOR[n] - 1.001) for n in (0, 1))
    column, row = x.astype(np.int64), y.astype(np.int64)
    right, down = x - column, y - row
    upper = light[row, column] * (1 - right) + light[row, column + 1] * right
    lower = light[row + 1, column] * (1 - right) + light[row + 1, column + 1] * right
    found: Floats = upper * (1 - down) + lower * down
    return found
