"""What moves with which device in a picture of the evenly lit scene: all of it with the camera, and the border of the
projector's picture with the projector as well.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.halves.borders import Places, going_on, lit_in, near_border, seen_border
from scanner.decoding.halves.tile_moments import TILE_PX, centres_of_tiles
from scanner.decoding.motion.rigid import PER_DEVICE, shifts_by_motion

# Where a camera pixel covers less of the projector's picture, in its pixels, its coordinates stand still.
_LEAST_AREA = 1e-3


@dataclass(frozen=True)
class Shown:
    """Pixels (H, W) that show the `scene` in the light, and those that show the `border` of the picture; by how much
    that border moves in each of T tiles, `of_border` (T, 2, 8), per px of each part of a motion, NaN where unknown.
    """

    scene: Bools
    border: Bools
    of_border: Floats


@dataclass(frozen=True)
class Edges:
    """Of a capture: `projector_px` (H, W, 2) in steps of `step_px`, NaN where unknown, by frames of which those along
    the axes of which `later` (2,) is 1 were taken after a motion; `places` of its tiles. `size` (width, height) of the
    projector.
    """

    projector_px: Floats32
    step_px: float
    places: Places
    later: Floats
    size: tuple[int, int]

    @cached_property
    def of_scene(self) -> Floats:
        """By how much the scene moves in each of T tiles, (T, 2, 8), per px of each part of a motion."""
        moved = self._of_devices.copy()
        moved[:, :, :PER_DEVICE] = 0.0
        return moved

    @cached_property
    def decoded(self) -> Shown:
        """By the pixels that are decoded: what hardly moved."""
        border = seen_border(self.projector_px, self.size, self.step_px)
        unknown = ~np.isfinite(self.places.gradient).all(axis=(1, 2))
        of_border = self._of_border.copy()
        of_border[unknown] = np.nan
        return Shown(self._lit & ~border, border, of_border)

    @cached_property
    def _of_border(self) -> Floats:
        gradient = np.nan_to_num(self._around.gradient)
        known = np.abs(np.linalg.det(gradient)) > _LEAST_AREA
        gradient[~known] = np.eye(2)
        moved = self._of_devices.copy()
        moved[:, :, :PER_DEVICE] = -np.linalg.solve(gradient, moved[:, :, :PER_DEVICE])
        moved[~known] = np.nan
        return moved

    def beside(self, motion: Floats, reach_px: float) -> Shown:
        """Within so many px of where the border was before a motion (8,), by the planes around it."""
        places = self._around
        by_motion = shifts_by_motion(self._centre, places.projector_px, places.gradient, self._camera_size, self.size)
        border = near_border(self.projector_px, places, by_motion @ motion * self.later, self.size, reach_px)
        return Shown(self._lit & ~border, border, self._of_border)

    def taken_back(self, picture: Floats32, motion: Floats) -> tuple[Floats32, Floats32]:
        """A picture (H, W) of the scene, and one of the border of the projector's picture, as before a motion (8,)."""
        width, height = self._camera_size
        right, down, roll, zoom = motion[PER_DEVICE:]
        middle = (np.array([width, height]) - 1) / 2
        turn = np.eye(2) + np.array([[zoom, -roll], [roll, zoom]]) / (width / 2)
        to = np.column_stack([turn, middle + np.array([right, down]) - turn @ middle])
        of_column, of_row = np.outer(np.arange(width), to[:, 0]), np.outer(np.arange(height), to[:, 1]) + to[:, 2]
        scene_px = (of_row[:, None] + of_column).astype(np.float32)
        by_projector = np.nan_to_num(self._of_border[:, :, :PER_DEVICE] @ motion[:PER_DEVICE])
        grid = by_projector.reshape(height // TILE_PX, width // TILE_PX, 2).astype(np.float32)
        covered = np.zeros((height, width, 2), np.float32)
        if grid.size:
            rows, columns = TILE_PX * grid.shape[0], TILE_PX * grid.shape[1]
            covered[:rows, :columns] = cv2.resize(grid, (columns, rows), interpolation=cv2.INTER_LINEAR)
        # Linear: OpenCV's cubic one does not keep ramps in their places, by up to 0.05 px.
        scene, border = (
            cv2.remap(
                picture, places[..., 0], places[..., 1], interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            for places in (scene_px, scene_px + covered)
        )
        return np.asarray(scene, np.float32), np.asarray(border, np.float32)

    @cached_property
    def _lit(self) -> Bools:
        # In the dark a camera's fixed pattern, which rests, is much of what is seen.
        return lit_in(self.projector_px)

    @property
    def _camera_size(self) -> tuple[int, int]:
        height, width, _ = self.projector_px.shape
        return width, height

    @cached_property
    def _centre(self) -> Floats:
        return centres_of_tiles(self.projector_px.shape[:2]).reshape(-1, 2)

    @cached_property
    def _around(self) -> Places:
        """Tiles that are partly lit or masked as well, as beyond the border."""
        return going_on(self.places, self.projector_px.shape[:2])

    @cached_property
    def _of_devices(self) -> Floats:
        """What the devices' own pictures do, (T, 2, 8): the projector's in its px."""
        # With this gradient; the sign is that of coordinates in the projector's.
        flat = np.broadcast_to(-np.eye(2), (len(self._centre), 2, 2))
        return shifts_by_motion(self._centre, self._around.projector_px, flat, self._camera_size, self.size)
