"""The motion of edges in a picture of the evenly lit scene.

The whole picture moves with the camera, and the border of the projector's picture also with the projector.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Floats32
from scanner.decoding.between_axes.borders import TilePlanes, extrapolated, lit_in, near_border, seen_border
from scanner.decoding.between_axes.registration import TileWarp, centres_of_tiles
from scanner.decoding.motion import PER_DEVICE, shifts_by_motion
from scanner.decoding.significance import NEGLIGIBLE


@dataclass(frozen=True)
class ScenePixels:
    """What the camera's pixels (H, W) show."""

    scene: Bools
    """The lit scene."""
    border: Bools
    """The border of the projector's picture."""
    of_border: Floats
    """(T, 2, 8): derivative of the border's shift in each of T tiles by each part of a motion, NaN where unknown."""


@dataclass(frozen=True)
class Edges:
    """The coordinates of a capture, some of whose axes were taken after a motion; sizes are (width, height)."""

    projector_px: Floats32
    """(H, W, 2): NaN where unknown."""
    step_px: float
    """The coordinates come in steps of this length."""
    places: TilePlanes
    """The planes of its tiles."""
    later: Floats
    """(2,): 1 for an axis that was taken after the motion, else 0."""
    size: tuple[int, int]
    """Of the projector's picture."""
    camera_size: tuple[int, int]
    """Of the camera's picture."""
    origin: tuple[int, int]
    """Camera pixel (x, y) of the first pixel."""

    @cached_property
    def of_scene(self) -> Floats:
        """(T, 2, 8): derivative of the scene's shift in each of T tiles by each part of a motion."""
        moved = self._of_devices.copy()
        moved[:, :, :PER_DEVICE] = 0.0
        return moved

    @cached_property
    def decoded(self) -> ScenePixels:
        """Scene and border from the decoded pixels, for small motions."""
        border = seen_border(self.projector_px, self.size, self.step_px)
        unknown = ~np.isfinite(self.places.gradient).all(axis=(1, 2))
        of_border = self._of_border.copy()
        of_border[unknown] = np.nan
        return ScenePixels(self._lit & ~border, border, of_border)

    @cached_property
    def _of_border(self) -> Floats:
        gradient = np.nan_to_num(self._around.gradient)
        known = np.abs(np.linalg.det(gradient)) > NEGLIGIBLE
        gradient[~known] = np.eye(2)
        moved = self._of_devices.copy()
        moved[:, :, :PER_DEVICE] = -np.linalg.solve(gradient, moved[:, :, :PER_DEVICE])
        moved[~known] = np.nan
        return moved

    def beside(self, motion: Floats, reach_px: float) -> ScenePixels:
        """Return scene and border, within `reach_px` of the border before a motion (8,), predicted by planes."""
        places = self._around
        by_motion = shifts_by_motion(self.centre, places.projector_px, places.gradient, self.camera_size, self.size)
        border = near_border(self.projector_px, places, by_motion @ motion * self.later, self.size, reach_px)
        return ScenePixels(self._lit & ~border, border, self._of_border)

    def warps(self, motion: Floats) -> tuple[TileWarp, TileWarp]:
        """Return where the scene and the border of the projector's picture are after a motion (8,)."""
        right, down, roll, zoom = motion[PER_DEVICE:]
        half = self.camera_size[0] / 2
        turned = np.eye(2) + np.array([[zoom, -roll], [roll, zoom]]) / half
        from_middle = self.centre - (np.array(self.camera_size) - 1) / 2
        scene = self.centre + np.array([right, down]) + from_middle @ (turned - np.eye(2)).T - np.array(self.origin)
        by_projector = np.nan_to_num(self._of_border[:, :, :PER_DEVICE] @ motion[:PER_DEVICE])
        return TileWarp(scene, turned), TileWarp(scene + by_projector, turned)

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
