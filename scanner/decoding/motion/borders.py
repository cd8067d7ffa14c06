"""What moves in a picture of the evenly lit scene: all of it with the camera, its border also with the projector.

The border of the projector's picture is the only feature of even light that moves with the projector.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from calib.numerics import Bools, Floats, Floats32, Ints, around, compiled
from scanner.decoding.motion.pixels import MOST_ROUGH_PX, PER_DEVICE, shifts_by_motion
from scanner.decoding.motion.registration import TILE_PX, TileWarp, centres_of_tiles, moments_of_tiles
from scanner.decoding.significance import FEWEST_PIXELS, NEGLIGIBLE

# Decoded pixels at most this far from the border, in projector px, locate it to this many camera px.
_NEAR_PX = 6.0
REACH_PX = 10
# A tile's plane is fitted to its own decoded pixels and its neighbours', in a window of this size, and extrapolated as
# many tiles beyond decoded ones: there the border of a picture that moved is masked.
_AROUND_TILES = 3


@dataclass(frozen=True)
class TilePlanes:
    """Coordinates of T tiles: `projector_px` (T, 2) in their middles, and the `gradient` (T, 2, 2) by camera x and y.

    NaN where the coordinates are unknown or not smooth.
    """

    projector_px: Floats
    gradient: Floats


def seen_border(projector_px: Floats32, size: tuple[int, int], step_px: float) -> Bools:
    """Return the pixels (H, W) near the border of a picture of (width, height), from the coordinates (H, W, 2) around
    them.

    The coordinates come in steps of `step_px`.
    """
    near = np.empty(projector_px.shape[:2], np.bool_)
    _note_inside(projector_px, np.array(size, np.float32) - 1, np.float32(_NEAR_PX + step_px / 2), near)
    return _around(near)


@compiled
def _note_inside(projector_px: Floats32, last_px: Floats32, near_px: np.float32, near: Bools) -> None:
    """Mark pixels whose known coordinates are within `near_px` of the border of the picture, or outside it."""
    for y in range(projector_px.shape[0]):
        for x in range(projector_px.shape[1]):
            across, down = projector_px[y, x, 0], projector_px[y, x, 1]
            least = min(min(across, last_px[0] - across), min(down, last_px[1] - down))
            near[y, x] = (across == across) & (down == down) & (least < near_px)


def near_border(
    projector_px: Floats32, places: TilePlanes, moved_px: Floats, size: tuple[int, int], reach_px: float
) -> Bools:
    """Return the pixels (H, W) within `reach_px` camera px of the border of a picture of (width, height).

    The border is located from the coordinates (H, W, 2) less the `moved_px` (T, 2) of their tile, or from the planes of
    the tiles where coordinates are unknown.
    """
    near = np.zeros(projector_px.shape[:2], np.bool_)
    steep = np.maximum(np.linalg.norm(places.gradient, axis=2), NEGLIGIBLE)
    smooth = np.isfinite(places.projector_px).all(axis=1) & np.isfinite(places.gradient).all(axis=(1, 2))
    planes = np.concatenate([places.projector_px[:, :, None], places.gradient], axis=2)
    last_px = np.array(size) - 1.0
    _note_near(projector_px, np.flatnonzero(smooth), planes, moved_px, 1 / steep, last_px, reach_px, TILE_PX, near)
    return near


@compiled
def _note_near(
    projector_px: Floats32,
    smooth: Ints,
    planes: Floats,
    moved_px: Floats,
    per_px: Floats,
    last_px: Floats,
    reach_px: float,
    tile_px: int,
    near: Bools,
) -> None:
    """Mark pixels of the `smooth` ones of T tiles; `planes` (T, 2, 3): coordinates of their middles, and gradients;
    `per_px` (T, 2): camera px for each projector px.
    """
    columns = near.shape[1] // tile_px
    last_x, last_y, half = last_px[0], last_px[1], (tile_px - 1) / 2
    for tile in smooth:
        top, left = tile // columns * tile_px, tile % columns * tile_px
        moved_x, moved_y = moved_px[tile, 0], moved_px[tile, 1]
        x_at, x_right, x_down = planes[tile, 0, 0], planes[tile, 0, 1], planes[tile, 0, 2]
        y_at, y_right, y_down = planes[tile, 1, 0], planes[tile, 1, 1], planes[tile, 1, 2]
        per_x, per_y = per_px[tile, 0], per_px[tile, 1]
        for row in range(tile_px):
            of_row, note = projector_px[top + row, left : left + tile_px], near[top + row, left : left + tile_px]
            for column in range(tile_px):
                x, y = np.float64(of_row[column, 0]), np.float64(of_row[column, 1])
                known = (x == x) & (y == y)
                right, down = column - half, row - half
                x = (x if known else x_at + x_right * right + x_down * down) - moved_x
                y = (y if known else y_at + y_right * right + y_down * down) - moved_y
                inside_px = min(min(x, last_x - x) * per_x, min(y, last_y - y) * per_y)
                note[column] = abs(inside_px) < reach_px


def part_around(projector_px: Floats32) -> tuple[slice, slice]:
    """Return the rows and columns, in whole tiles, of the known coordinates (H, W, 2) with a margin that includes the
    border.

    All of the image if none is known.
    """
    known = _known(projector_px)
    part = around(known if known.any() else ~known, 2 * _AROUND_TILES * TILE_PX)
    rows, columns = (
        slice(span.start // TILE_PX * TILE_PX, min(size // TILE_PX, -(-span.stop // TILE_PX)) * TILE_PX)
        for span, size in zip(part, known.shape, strict=True)
    )
    return rows, columns


def lit_in(projector_px: Floats32) -> Bools:
    """Return the pixels (H, W) in the projector's light, from the known coordinates (H, W, 2)."""
    return _around(_known(projector_px))


def _known(projector_px: Floats32) -> Bools:
    return np.isfinite(projector_px[..., 0]) & np.isfinite(projector_px[..., 1])


def _around(pixels: Bools) -> Bools:
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * REACH_PX + 1,) * 2)
    return cv2.dilate(pixels.astype(np.uint8), disc).astype(np.bool_)


def places_of_tiles(projector_px: Floats32, step_px: float) -> TilePlanes:
    """Fit planes to the coordinates (H, W, 2) of all camera pixels, in steps of `step_px`, NaN where unknown."""
    height, width, _ = projector_px.shape
    known = _known(projector_px)
    moments = moments_of_tiles(projector_px, known)
    around = cv2.boxFilter(
        moments.reshape(*moments.shape[:2], -1),
        -1,
        (_AROUND_TILES,) * 2,
        normalize=False,
        borderType=cv2.BORDER_CONSTANT,
    ).reshape(-1, 5, 5)
    planes = np.linalg.solve(around[:, :3, :3] + 1e-6 * np.eye(3), around[:, :3, 3:])
    squares = np.trace(around[:, 3:, 3:] - around[:, 3:, :3] @ planes, axis1=1, axis2=2)
    count = around[:, 0, 0]
    smooth = (count >= FEWEST_PIXELS) & (squares < (MOST_ROUGH_PX**2 + 2 * step_px**2 / 12) * count)
    smooth_planes: Floats = np.where(smooth[:, None, None], planes, np.nan)
    offset = centres_of_tiles(known.shape).reshape(-1, 2) - np.array([width, height]) / 2
    at_centre: Floats = smooth_planes[:, 0] + np.einsum("ta,tac->tc", offset, smooth_planes[:, 1:])
    return TilePlanes(at_centre, smooth_planes[:, 1:].transpose(0, 2, 1))


def extrapolated(places: TilePlanes, shape: tuple[int, ...]) -> TilePlanes:
    """Extrapolate the planes to unknown tiles of an image of `shape` (H, W), from the nearest known tile."""
    rows, columns = (size // TILE_PX for size in shape)
    unknown = ~np.isfinite(places.gradient).all(axis=(1, 2))
    if unknown.all():
        return places
    far, label = cv2.distanceTransformWithLabels(
        unknown.reshape(rows, columns).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(label.max()) + 1, np.int64)
    known = np.flatnonzero(~unknown)
    of_label[label.reshape(-1)[known]] = known
    nearest = of_label[label.reshape(-1)]
    gradient = places.gradient[nearest]
    centre = centres_of_tiles(shape).reshape(-1, 2)
    projector_px = places.projector_px[nearest] + np.einsum("tac,tc->ta", gradient, centre - centre[nearest])
    beyond = far.reshape(-1) > _AROUND_TILES
    projector_px[beyond], gradient[beyond] = np.nan, np.nan
    return TilePlanes(projector_px, gradient)


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
