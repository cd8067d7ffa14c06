"""The motion of edges in a picture of the evenly lit scene.

The whole picture moves with the camera, and the border of the projector's picture also with the projector.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Floats32
from scanner.decoding.between_axes.borders import TilePlanes, extrapolated, lit_in, near_border, seen_border
from scanner.decoding.between_axes.registration import Warp, centres_of_tiles
from scanner.decoding.motion import shifts_by_motion
from scanner.decoding.motion.rigid import PER_DEVICE
from scanner.decoding.significance import NEGLIGIBLE


@dataclass(frozen=True)
class Shown:
    """Pixels (H, W) that show the lit `scene`, and those that show the `border` of the projector's picture.

    `of_border` (T, 2, 8): derivative of the border's shift in each of T tiles by each part of a motion, NaN where
    unknown.
    """

    scene: Bools
    border: Bools
    of_border: Floats


@dataclass(frozen=True)
class Edges:
    """The coordinates of a capture whose axes with `later` (2,) = 1 were taken after a motion.

    `projector_px` (H, W, 2): in steps of `step_px`, NaN where unknown. `places`: the planes of its tiles. `size`,
    `camera_size`: (width, height) of the devices. `origin`: camera pixel (x, y) of the first pixel.
    """

    projector_px: Floats32
    step_px: float
    places: TilePlanes
    later: Floats
    size: tuple[int, int]
    camera_size: tuple[int, int]
    origin: tuple[int, int]

    @cached_property
    def of_scene(self) -> Floats:
        """(T, 2, 8): derivative of the scene's shift in each of T tiles by each part of a motion."""
        moved = self._of_devices.copy()
        moved[:, :, :PER_DEVICE] = 0.0
        return moved

    @cached_property
    def decoded(self) -> Shown:
        """Scene and border from the decoded pixels, for small motions."""
        border = seen_border(self.projector_px, self.size, self.step_px)
        unknown = ~np.isfinite(self.places.gradient).all(axis=(1, 2))
        of_border = self._of_border.copy()
        of_border[unknown] = np.nan
        return Shown(self._lit & ~border, border, of_border)

    @cached_property
    def _of_border(self) -> Floats:
        gradient = np.nan_to_num(self._around.gradient)
        known = np.abs(np.linalg.det(gradient)) > NEGLIGIBLE
        gradient[~known] = np.eye(2)
        moved = self._of_devices.copy()
        moved[:, :, :PER_DEVICE] = -np.linalg.solve(gradient, moved[:, :, :PER_DEVICE])
        moved[~known] = np.nan
        return moved

    def beside(self, motion: Floats, reach_px: float) -> Shown:
        """Return scene and border, within `reach_px` of the border before a motion (8,), predicted by planes."""
        places = self._around
        by_motion = shifts_by_motion(self.centre, places.projector_px, places.gradient, self.camera_size, self.size)
        border = near_border(self.projector_px, places, by_motion @ motion * self.later, self.size, reach_px)
        return Shown(self._lit & ~border, border, self._of_border)

    def warps(self, motion: Floats) -> tuple[Warp, Warp]:
        """Return where the scene and the border of the projector's picture are after a motion (8,)."""
        right, down, roll, zoom = motion[PER_DEVICE:]
        half = self.camera_size[0] / 2
        turned = np.eye(2) + np.array([[zoom, -roll], [roll, zoom]]) / half
        from_middle = self.centre - (np.array(self.camera_size) - 1) / 2
        scene = self.centre + np.array([right, down]) + from_middle @ (turned - np.eye(2)).T - np.array(self.origin)
        by_projector = np.nan_to_num(self._of_border[:, :, :PER_DEVICE] @ motion[:PER_DEVICE])
        return Warp(scene, turned), Warp(scene + by_projector, turned)

    @cached_property
    def _lit(self) -> Bools:
        # In the dark, the camera's fixed pattern, which does not move, dominates.
        return lit_in(self.projector_px)

    @cached_property
    def centre(self) -> Floats:
        """(T, 2): middles of the tiles in the camera's picture."""
        centre: Floats = centres_of_tiles(self.projector_px.shape[:2]).reshape(-1, 2) + np.array(self.origin)
        return centre

    @cached_property
    def _around(self) -> TilePlanes:
        """Planes extrapolated to tiles that are partly lit or masked, and beyond the border."""
        return extrapolated(self.places, self.projector_px.shape[:2])

    @cached_property
    def _of_devices(self) -> Floats:
        """(T, 2, 8): derivative of the motion of each device's own picture, the projector's in its px."""
        # With this gradient, the shift of coordinates is that of the picture; the sign is that of projector
        # coordinates.
        flat = np.broadcast_to(-np.eye(2), (len(self.centre), 2, 2))
        return shifts_by_motion(self.centre, self._around.projector_px, flat, self.camera_size, self.size)
