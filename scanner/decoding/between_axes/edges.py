"""What moves with which device in a picture of the evenly lit scene: all of it with the camera, and the border of the
projector's picture with the projector as well.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.between_axes.borders import Places, going_on, lit_in, near_border, seen_border
from scanner.decoding.between_axes.registration import Warp, centres_of_tiles
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
    the axes of which `later` (2,) is 1 were taken after a motion; `places` of its tiles. `size` and `camera_size`
    (width, height) of the devices, whose pixel (x, y) at `origin` is the first of these.
    """

    projector_px: Floats32
    step_px: float
    places: Places
    later: Floats
    size: tuple[int, int]
    camera_size: tuple[int, int]
    origin: tuple[int, int]

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
        by_motion = shifts_by_motion(self.centre, places.projector_px, places.gradient, self.camera_size, self.size)
        border = near_border(self.projector_px, places, by_motion @ motion * self.later, self.size, reach_px)
        return Shown(self._lit & ~border, border, self._of_border)

    def warps(self, motion: Floats) -> tuple[Warp, Warp]:
        """Where the scene is, and where the border of the projector's picture is, after a motion (8,)."""
        right, down, roll, zoom = motion[PER_DEVICE:]
        half = self.camera_size[0] / 2
        turned = np.eye(2) + np.array([[zoom, -roll], [roll, zoom]]) / half
        from_middle = self.centre - (np.array(self.camera_size) - 1) / 2
        scene = self.centre + np.array([right, down]) + from_middle @ (turned - np.eye(2)).T - np.array(self.origin)
        by_projector = np.nan_to_num(self._of_border[:, :, :PER_DEVICE] @ motion[:PER_DEVICE])
        return Warp(scene, turned), Warp(scene + by_projector, turned)

    @cached_property
    def _lit(self) -> Bools:
        # In the dark a camera's fixed pattern, which rests, is much of what is seen.
        return lit_in(self.projector_px)

    @cached_property
    def centre(self) -> Floats:
        """Of each of T tiles, (T, 2), in the camera's picture."""
        centre: Floats = centres_of_tiles(self.projector_px.shape[:2]).reshape(-1, 2) + np.array(self.origin)
        return centre

    @cached_property
    def _around(self) -> Places:
        """Tiles that are partly lit or masked as well, as beyond the border."""
        return going_on(self.places, self.projector_px.shape[:2])

    @cached_property
    def _of_devices(self) -> Floats:
        """What the devices' own pictures do, (T, 2, 8): the projector's in its px."""
        # With this gradient; the sign is that of coordinates in the projector's.
        flat = np.broadcast_to(-np.eye(2), (len(self.centre), 2, 2))
        return shifts_by_motion(self.centre, self._around.projector_px, flat, self.camera_size, self.size)
