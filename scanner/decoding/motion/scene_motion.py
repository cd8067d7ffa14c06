"""The scene in the camera's picture as it moves: all of it with the camera, its border also with the projector.

The border of the projector's picture is the only feature of even light that moves with the projector.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Floats32, Ints, Window, around, at_random, compiled
from scanner.decoding.motion.motion_estimate import SUSPECTED_PX
from scanner.decoding.motion.registration import (
    AROUND_TILES,
    TILE_PX,
    TilePlanes,
    TileWarp,
    centres_of_tiles,
    planes_of_tiles,
    shifts_of_tiles,
)
from scanner.decoding.motion.rigid_motion import COLUMNS, PER_DEVICE, RigidFit, fit_motion, shifts_of_picture
from scanner.decoding.significance import HALF, HUBER_SIGMAS, NEGLIGIBLE, SIGNIFICANT_SIGMAS

# Light reaches this far, in cells of some pixels, from pixels that are decoded.
_LIT_CELLS, _CELL_PX = 2, 4
# Least ratio of the determinant of a gradient to its squares: with less, pixels on a line decided the plane.
_MOST_OBLIQUE = 0.05
SCENE, BORDER = 1, 2


@dataclass(frozen=True)
class LitScene:
    """What pixels of the camera's picture, reduced by `scale`, show; sizes are (width, height), px are reduced ones.

    One axis may have been measured after a motion of the devices.
    """

    projector_px: Floats32
    """(H, W, 2): NaN where unknown."""
    step_px: float
    """The coordinates come in steps of this length."""
    later: Floats
    """(2,): 1 for an axis that was taken after the motion, else 0."""
    size: tuple[int, int]
    """Of the projector's picture."""
    camera_size: tuple[int, int]
    """Of the camera's picture, reduced."""
    origin: tuple[int, int]
    """Pixel (x, y) of the camera's picture at which this part of it begins."""
    scale: int
    """Camera pixels along a reduced one."""

    @cached_property
    def centre(self) -> Floats:
        """(T, 2): middles of the tiles in the camera's picture."""
        centre: Floats = centres_of_tiles(self.projector_px.shape[:2]) + np.array(self.origin)
        return centre

    @cached_property
    def planes(self) -> TilePlanes:
        """The planes of the tiles."""
        return planes_of_tiles(self.projector_px, self.step_px)

    @cached_property
    def _around(self) -> TilePlanes:
        """Planes extrapolated to tiles that are partly lit or masked, and beyond the border."""
        return self.planes.extrapolated(self.projector_px.shape[:2])

    @cached_property
    def by_scene(self) -> Floats:
        """(T, 2, 8): derivative of the scene's shift in each tile by each part of a motion, in px of the devices."""
        by_motion = np.zeros((len(self.centre), 2, COLUMNS))
        by_motion[:, :, PER_DEVICE:] = shifts_of_picture(self.centre, self.camera_size) / self.scale
        return by_motion

    @cached_property
    def _of_projector(self) -> Floats:
        """(T, 2, 4): the shift of the projector's picture in its px, NaN where unknown."""
        return shifts_of_picture(self._around.projector_px, self.size)

    @cached_property
    def by_border(self) -> Floats:
        """(T, 2, 8): that of the shift of the border of the projector's picture, NaN where unknown."""
        by_motion, ((a, b), (c, d)) = self.by_scene.copy(), np.moveaxis(self._around.gradient, 0, 2)
        determinant = a * d - b * c
        adjugate = np.moveaxis(np.array([[d, -b], [-c, a]]), 2, 0)
        known = np.abs(determinant) > _MOST_OBLIQUE * (a * a + b * b + c * c + d * d)
        inverse = adjugate / np.where(known, determinant, np.nan)[:, None, None]
        by_motion[:, :, :PER_DEVICE] = inverse @ self._of_projector
        return by_motion

    @cached_property
    def at_rest(self) -> NDArray[np.uint8]:
        """(H, W): the labels without motion, none at the border in tiles that have no plane of their own."""
        return self.labels(np.zeros(COLUMNS), REACH_PX, self.planes.known)

    def labels(self, motion: Floats, reach_px: float, usable: Bools | None = None) -> NDArray[np.uint8]:
        """Return what each pixel (H, W) shows before a motion (8,): `SCENE`; `BORDER`, within the reach of it, in the
        `usable` ones of T tiles; or 0, nothing that is lit.

        In the dark, the camera's fixed pattern, which does not move, dominates.
        """
        planes, labels = self._around, self._lit.copy()
        moved_px = np.zeros_like(planes.projector_px)
        if motion.any():
            moved_px -= self._of_projector @ motion[:PER_DEVICE]
            moved_px -= np.einsum("tab,tb->ta", planes.gradient, self.by_scene @ motion)
        steep = np.maximum(np.hypot(planes.gradient[..., 0], planes.gradient[..., 1]), NEGLIGIBLE)
        planar = np.concatenate([planes.projector_px[:, :, None], planes.gradient], axis=2)
        last_px, known = np.array(self.size) - 1.0, np.flatnonzero(planes.known)
        marks = np.full(len(steep), BORDER, np.uint8)
        if usable is not None:
            marks[~usable] = 0
        moved_px *= self.later
        _label_border(self.projector_px, known, planar, moved_px, 1 / steep, last_px, reach_px, TILE_PX, marks, labels)
        return labels

    @cached_property
    def _lit(self) -> NDArray[np.uint8]:
        """(H, W): `SCENE` in the projector's light."""
        known = np.isfinite(self.projector_px[..., 0]).astype(np.uint8) * 255
        height, width = known.shape
        cells = cv2.resize(known, (-(-width // _CELL_PX), -(-height // _CELL_PX)), interpolation=cv2.INTER_AREA) > 0
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _LIT_CELLS + 1,) * 2)
        lit = cv2.dilate(cells.astype(np.uint8) * SCENE, disc)
        return np.asarray(cv2.resize(lit, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)

    def warps(self, motion: Floats) -> tuple[TileWarp, TileWarp]:
        """Return where the scene and the border of the projector's picture are after a motion (8,), in this part."""
        right, down, roll, zoom = motion[PER_DEVICE:] / self.scale
        turned = np.eye(2) + np.array([[zoom, -roll], [roll, zoom]]) / (self.camera_size[0] / 2)
        from_middle = self.centre - (np.array(self.camera_size) - 1) / 2
        scene = self.centre + np.array([right, down]) + from_middle @ (turned - np.eye(2)).T - np.array(self.origin)
        by_projector = np.nan_to_num(self.by_border[:, :, :PER_DEVICE] @ motion[:PER_DEVICE])
        return TileWarp(scene, turned), TileWarp(scene + by_projector, turned)


def part_around(projector_px: Floats32, scale: int) -> Window:
    """Return the rows and columns, in whole reduced tiles, of the known coordinates (H, W, 2) with a margin that
    includes the border; all of the image if none is known.
    """
    known: Bools = np.isfinite(projector_px[::_CELL_PX, ::_CELL_PX, 0])
    tile_px = scale * TILE_PX
    spans = around(known if known.any() else ~known, -(-2 * AROUND_TILES * tile_px // _CELL_PX))
    rows, columns = (
        slice(
            _CELL_PX * span.start // tile_px * tile_px,
            min(size // tile_px, -(-_CELL_PX * span.stop // tile_px)) * tile_px,
        )
        for span, size in zip(spans, projector_px.shape[:2], strict=True)
    )
    return rows, columns


@compiled
def _label_border(
    projector_px: Floats32,
    known: Ints,
    planes: Floats,
    moved_px: Floats,
    per_px: Floats,
    last_px: Floats,
    reach_px: float,
    tile_px: int,
    marks: NDArray[np.uint8],
    labels: NDArray[np.uint8],
) -> None:
    """Label pixels (H, W) of the `known` ones of T tiles by the `marks` (T,) of their tile, within `reach_px` of the
    border of a picture whose last pixel is `last_px`: located from the coordinates (H, W, 2) less the `moved_px` (T, 2)
    of the tile, or from its plane.

    `planes` (T, 2, 3): coordinates of middles, and gradients; `per_px` (T, 2): camera px for each projector px.
    """
    columns = labels.shape[1] // tile_px
    last_x, last_y, half = last_px[0], last_px[1], (tile_px - 1) / 2
    for tile in known:
        top, left = tile // columns * tile_px, tile % columns * tile_px
        moved_x, moved_y, per_x, per_y = moved_px[tile, 0], moved_px[tile, 1], per_px[tile, 0], per_px[tile, 1]
        x_at, x_right, x_down = planes[tile, 0, 0], planes[tile, 0, 1], planes[tile, 0, 2]
        y_at, y_right, y_down = planes[tile, 1, 0], planes[tile, 1, 1], planes[tile, 1, 2]
        x, y = x_at - moved_x, y_at - moved_y
        inside_px = min(min(x, last_x - x) * per_x, min(y, last_y - y) * per_y)
        if abs(inside_px) > reach_px + 2 * tile_px:
            continue
        for row in range(tile_px):
            of_row, label = projector_px[top + row, left : left + tile_px], labels[top + row, left : left + tile_px]
            for column in range(tile_px):
                x, y = np.float64(of_row[column, 0]), np.float64(of_row[column, 1])
                known_here = (x == x) & (y == y)
                right, down = column - half, row - half
                x = (x if known_here else x_at + x_right * right + x_down * down) - moved_x
                y = (y if known_here else y_at + y_right * right + y_down * down) - moved_y
                inside_px = min(min(x, last_x - x) * per_x, min(y, last_y - y) * per_y)
                if abs(inside_px) < reach_px:
                    label[column] = marks[tile]


# Systematic error from fringe ripple and fixed patterns, in captures of real devices at rest.
_SYSTEMATIC_PX = 0.01
# Prior standard deviations: a bump turns a device; it hardly rolls it, and does not change its zoom.
_EXPECTED_PX = SUSPECTED_PX * np.tile([1.0, 1.0, 0.3, 0.3], 2)
# Blurs of the coarse-to-fine fit of a motion that is large compared with the sharpness of edges.
_COARSE_TO_FINE_PX = (6.0, 3.0, 1.5, 0.0, 0.0)
# A motion that is small compared with it, and the last step of a fit that has converged, in the camera's reduced px.
_SMALL_PX = 0.2
# The border is searched for within this many px of where coordinates locate it, and of its place predicted by a fit;
# more where the prediction is uncertain, plus this multiple of the blur. Everything outside is scene.
REACH_PX, _PREDICTED_PX, _REACH_OF_BLUR = 10.0, 4.0, 2.0
# Tiles of the scene, as many as a picture of a third of a megapixel has (benchmarks/bench_motion.py): with more, the
# systematic error is what remains.
_MOST_TILES = 1280
# Tiles within squares of this side may have correlated errors.
_GROUP_TILES = 4
_AT_REST = np.zeros(COLUMNS)

Pictures = tuple[Floats32, Floats32]


@dataclass(frozen=True)
class _Observations:
    """Shifts of R tiles that remain beside a motion, in standard deviations, as `fit_motion` takes them."""

    design: Floats
    seen: Floats
    cluster: Ints
    differ: float
    """Squared differences of the pictures, weighted by their squared slopes."""
    limit: float
    """Outlier threshold in standard deviations."""

    def fit(self, expected_px: Floats) -> RigidFit:
        """Fit what remains, with a prior for unobservable parts."""
        fit = fit_motion(self.design, self.seen, self.cluster, expected_px, self.limit, least_scale=1.0)
        return replace(fit, covariance=fit.covariance + _SYSTEMATIC_PX**2 * np.eye(COLUMNS))


class SceneRegistration:
    """Registers two pictures (H, W) of a scene, the earlier and the later one, coarse to fine."""

    def __init__(self, pictures: Pictures, scene: LitScene) -> None:
        self._scene = scene
        self._small_px = _SMALL_PX * np.repeat([1, scene.scale], PER_DEVICE)
        self._pictures = {0.0: pictures}
        self._at_rest = self._observe(_AT_REST, 0.0, scene.at_rest)
        self._coarsely = self._observe_beside(_AT_REST, _COARSE_TO_FINE_PX[0])

    def fit(self) -> RigidFit:
        """Return the motion from the earlier picture to the later one, of one device if the other has hardly moved."""
        fit = self._measured(_EXPECTED_PX)
        devices = np.split(np.arange(COLUMNS), [PER_DEVICE])
        sure = [
            replace(fit, motion=fit.motion[columns], covariance=fit.covariance[np.ix_(columns, columns)]).significance
            for columns in devices
        ]
        if not min(sure) < SIGNIFICANT_SIGMAS < max(sure):
            return fit
        expected_px = _EXPECTED_PX.copy()
        expected_px[devices[int(np.argmin(sure))]] = NEGLIGIBLE
        return replace(fit, motion=self._measured(expected_px).motion)

    def _measured(self, expected_px: Floats) -> RigidFit:
        """Fit the motion, coarse to fine if it is large: of both devices if that is reliable, else of the camera."""
        fit, step = self._at_rest.fit(expected_px), self._coarsely.fit(expected_px)
        if self._is_small(fit.motion) and self._is_small(step.motion):
            return fit
        motion = step.motion
        for blur_px in _COARSE_TO_FINE_PX[1:]:
            step = self._observe_beside(motion, blur_px).fit(expected_px)
            motion = motion + step.motion
        # Without texture it finds spurious motion, which explains little of the differences at edges.
        if self._is_small(step.motion) and self._explained(motion) > HALF:
            return replace(step, motion=motion)
        if self._is_small(fit.motion):
            return fit
        camera = _AT_REST.copy()
        for blur_px in _COARSE_TO_FINE_PX:
            fit = self._observe(camera, blur_px, self._scene.at_rest).fit(expected_px)
            camera[PER_DEVICE:] += fit.motion[PER_DEVICE:]
        return replace(fit, motion=np.concatenate([fit.motion[:PER_DEVICE], camera[PER_DEVICE:]]))

    def _is_small(self, motion: Floats) -> bool:
        return bool((np.abs(motion) < self._small_px).all())

    def _explained(self, motion: Floats) -> float:
        """Return the share of the squared difference of the pictures at edges that a motion (8,) explains."""
        labels = self._scene.labels(motion, _PREDICTED_PX)
        remaining, differ = (self._observe(of, 0.0, labels).differ for of in (motion, _AT_REST))
        return 1 - remaining / max(differ, 1e-12)

    def _observe_beside(self, motion: Floats, blur_px: float) -> _Observations:
        """Observe what remains beside a motion (8,) at a blur, with the border where the planes predict it.

        While the border is uncertain, no tile is down-weighted: most of the border may run along the motion.
        """
        reach_px = REACH_PX + _REACH_OF_BLUR * blur_px if blur_px else _PREDICTED_PX
        labels = self._scene.labels(motion, reach_px)
        return self._observe(motion, blur_px, labels, anywhere=blur_px > 0)

    def _observe(
        self, motion: Floats, blur_px: float, labels: NDArray[np.uint8], *, anywhere: bool = False
    ) -> _Observations:
        """Observe what remains beside a motion (8,), with `labels` (H, W); a border that may be `anywhere` has no gain
        of its own, and no outliers.
        """
        pictures, scene = self._blurred(blur_px), self._scene
        of_scene, of_border = scene.warps(motion)
        tiles = at_random(len(scene.centre), _MOST_TILES)
        known = np.flatnonzero(np.isfinite(scene.by_border).all(axis=(1, 2)))
        own = shifts_of_tiles(pictures, labels, SCENE, of_scene, tiles)
        border = shifts_of_tiles(pictures, labels, BORDER, of_border, known, own_light=not anywhere)
        numbers = np.concatenate([own.tiles, border.tiles])
        by_motion = np.concatenate([scene.by_scene[own.tiles], scene.by_border[border.tiles]])
        columns = labels.shape[1] // TILE_PX
        return _Observations(
            np.concatenate([own.slopes, border.slopes]) @ by_motion,
            np.concatenate([own.seen, border.seen]),
            numbers // columns // _GROUP_TILES * columns + numbers % columns // _GROUP_TILES,
            own.differ + border.differ,
            np.inf if anywhere else HUBER_SIGMAS,
        )

    def _blurred(self, blur_px: float) -> Pictures:
        """Return the pictures (H, W) or, blurred, at half their size."""
        if blur_px not in self._pictures:
            sharp = self._pictures[0.0]
            halves = (cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for picture in sharp)
            before, after = (np.asarray(cv2.GaussianBlur(half, (0, 0), blur_px / 2), np.float32) for half in halves)
            self._pictures[blur_px] = before, after
        return self._pictures[blur_px]
