"""What each camera pixel sees of the scene, as matrices. Rays are cast once for all pictures.

A pixel that sees one surface outside the projector's light needs one ray. Every other pixel gets a grid of rays, which
averages edges, shadows and fringes over the pixel's area.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, sparse

from calib.numerics import Bools, Floats, Ints, in_parallel
from hw.simulated.arrays import Indices, sparse_matrix
from hw.simulated.board import SimulatedBoard, with_board
from hw.simulated.device import PlacedDevice
from hw.simulated.illumination import SPILL_PX, ProjectorLight
from hw.simulated.mesh import RadiosityMesh
from hw.simulated.picture import PictureOptics
from hw.simulated.shapes import Block
from hw.simulated.texture import Texture

_CAMERA_VIGNETTING = 0.15
_OPPOSITE_WALL = 3
_BESIDE = 2  # pixels within which a corner of a board, however it is turned, has the centre of one
_STRIP_PIXELS = 1 << 14  # small enough for its arrays to stay in cache


@dataclass(frozen=True)
class Footprints:
    """Linear maps to the brightness of camera pixels, one row per pixel.

    The brightness is `direct` times the projector's fine image (`PictureOptics.blurred`) plus `indirect` times the
    irradiance of the mesh's nodes.
    """

    direct: sparse.csr_array
    indirect: sparse.csr_array

    def of(self, pixels: slice) -> "Footprints":
        """Those of some pixels."""
        return Footprints(self.direct[pixels], self.indirect[pixels])


@dataclass(frozen=True)
class _Seen:
    """What n camera rays hit: `surface` (n,), `points` (3, n), `uv` (2, n).

    `gain` (n,): from the irradiance there to brightness in the camera.
    """

    surface: Ints
    points: Floats
    uv: Floats
    gain: Floats


@dataclass(frozen=True)
class FootprintCaster:
    """Casts the rays of camera pixels, one strip of rows at a time, with `samples` × `samples` rays per detailed pixel.

    `stand_in` (nodes,): the node whose light replaces that of each node. `painted` (surfaces,): the surface whose
    texture and mesh each surface of the scene uses; None if each uses its own. `board`: the board in front of the
    scene.
    """

    light: ProjectorLight
    camera: PlacedDevice
    texture: Texture
    picture: PictureOptics
    mesh: RadiosityMesh
    stand_in: Indices
    samples: int
    painted: Ints | None = None
    board: SimulatedBoard | None = None

    def moved(self, camera: PlacedDevice, projector: PlacedDevice, *blocks: Block) -> "FootprintCaster":
        """The same caster with moved devices and additional `blocks` in the scene, painted like a wall."""
        scene, painted = self.light.scene, None
        if blocks:
            # Surfaces are numbered in this order: room, blocks, spheres.
            known = np.arange(scene.surface_count)
            painted = np.insert(known, scene.sphere_surface, np.full(6 * len(blocks), _OPPOSITE_WALL)).astype(np.int32)
            scene = replace(scene, blocks=(*scene.blocks, *blocks))
        return replace(self, camera=camera, light=ProjectorLight(scene, projector), painted=painted)

    def cast(self, bare: Footprints | None = None) -> Footprints:
        """The footprints of all pixels of the camera; `bare`: those without the board, if they are known."""
        optics = self.camera.optics
        step = max(1, _STRIP_PIXELS // optics.width)
        strips = [range(row, min(row + step, optics.height)) for row in range(0, optics.height, step)]
        parts = in_parallel(lambda rows: self.strip(rows, bare), strips)
        return Footprints(
            sparse.vstack([part.direct for part in parts], format="csr"),
            sparse.vstack([part.indirect for part in parts], format="csr"),
        )

    def strip(self, rows: range, bare: Footprints | None = None) -> Footprints:
        """The footprints of all pixels in some rows; `bare`: of the whole camera, without the board."""
        width = self.camera.optics.width
        centres = _pixel_centres(rows, width)
        offsets = (np.arange(self.samples) + 0.5) / self.samples - 0.5
        within = np.stack(np.meshgrid(offsets, offsets)).reshape(2, 1, -1)
        if bare is None:
            detailed = np.flatnonzero(self._detailed(rows))
            points = self._see((centres[:, detailed, None] + within).reshape(2, -1))
            room = Footprints(
                self._direct(detailed, points, centres.shape[1]), self._indirect(detailed, points, centres)
            )
        else:
            room = bare.of(slice(rows.start * width, rows.stop * width))
        if self.board is None:
            return room
        return self._with_board(room, self.board, centres, self._near_board(rows, self.board), within)

    def _with_board(
        self, room: Footprints, board: SimulatedBoard, centres: Floats, near: Indices, within: Floats
    ) -> Footprints:
        """The same footprints with the board in front. Pixels `near` it get `samples` × `samples` rays."""
        per_pixel = self.samples**2
        pixels = (centres[:, near, None] + within).reshape(2, -1)
        uv, hit = board.intersect(self.camera.centre, self.camera.rays(pixels))
        struck = np.flatnonzero(hit)
        uv = uv[:, struck]
        points, pixel = board.points(uv), near[struck // per_pixel]
        gain = board.albedo(uv) * self.camera.optics.vignetting(pixels[:, struck], _CAMERA_VIGNETTING)
        projected, irradiance = self.light.unoccluded(points, board.normals(uv))
        texels, weights = self.picture.interpolate(projected[:, irradiance > 0])
        lit = np.flatnonzero(irradiance)
        weights *= (gain[lit] * irradiance[lit] / per_pixel)[:, None]
        direct = sparse_matrix(pixel[lit], texels, weights, (centres.shape[1], self.picture.fine_count))
        return Footprints(*with_board((room.direct, room.indirect), pixel, gain, direct, per_pixel))

    def _near_board(self, rows: range, board: SimulatedBoard) -> Indices:
        """Pixels of some rows of which any part may see the board: the centre of one beside them does."""
        wider = range(rows.start - _BESIDE, rows.stop + _BESIDE)
        width = self.camera.optics.width + 2 * _BESIDE
        centres = _pixel_centres(wider, width) - [[_BESIDE], [0.0]]
        _, hit = board.intersect(self.camera.centre, self.camera.rays(centres))
        near = ndimage.maximum_filter(hit.reshape(len(wider), width), 2 * _BESIDE + 1)
        return np.flatnonzero(near[_BESIDE:-_BESIDE, _BESIDE:-_BESIDE])

    def _detailed(self, rows: range) -> Bools:
        """Pixels that may see several surfaces or the projector's light, (pixels,), judged by their neighbours."""
        width = self.camera.optics.width
        wider = range(rows.start - 1, rows.stop + 1)
        directions = self.camera.rays(_pixel_centres(wider, width + 2) - [[1.0], [0.0]])
        t, surface = self.light.scene.cast(self.camera.centre[:, None], directions)
        pixels, _ = self.light.projector.project(self.camera.centre[:, None] + t * directions)
        lit = self.light.projector.optics.sees(pixels, SPILL_PX)
        # −1 marks lit pixels: a pixel whose neighbours show the same unlit surface is not detailed.
        kind = np.where(lit, -1, surface).reshape(len(wider), width + 2)
        lowest, highest = ndimage.minimum_filter(kind, 3), ndimage.maximum_filter(kind, 3)
        detailed: Bools = ((lowest != highest) | (lowest < 0))[1:-1, 1:-1].ravel()
        return detailed

    def _see(self, pixels: Floats) -> _Seen:
        directions = self.camera.rays(pixels)
        t, surface = self.light.scene.cast(self.camera.centre[:, None], directions)
        points = self.camera.centre[:, None] + t * directions
        uv = self.light.scene.surface_coordinates(surface, points)
        gain = self.texture.albedo(self._paint(surface), uv) * self.camera.optics.vignetting(pixels, _CAMERA_VIGNETTING)
        return _Seen(surface, points, uv, gain)

    def _paint(self, surface: Ints) -> Ints:
        return surface if self.painted is None else self.painted[surface]

    def _direct(self, pixel: Indices, points: _Seen, count: int) -> sparse.csr_array:
        projected, irradiance = self.light.direct(points.surface, points.points)
        lit = np.flatnonzero(irradiance)
        texels, weights = self.picture.interpolate(projected[:, lit])
        weights *= (points.gain[lit] * irradiance[lit] / self.samples**2)[:, None]
        return sparse_matrix(pixel[lit // self.samples**2], texels, weights, (count, self.picture.fine_count))

    def _indirect(self, detailed: Indices, points: _Seen, centres: Floats) -> sparse.csr_array:
        """Pixels that see one surface take the light at their centre. Others average over their samples."""
        per_pixel = self.samples**2
        surface = points.surface.reshape(-1, per_pixel)
        mixed = (surface != surface[:, :1]).any(axis=1)

        count = centres.shape[1]
        single = np.ones(count, np.bool_)
        single[detailed[mixed]] = False
        whole = self._see(centres[:, single])
        gain = np.zeros(count)
        gain[single] = whole.gain
        gain[detailed] = points.gain.reshape(-1, per_pixel).mean(axis=1)
        nodes, weights = self.mesh.interpolate(self._paint(whole.surface), whole.uv)
        weights *= gain[single, None]

        parts = np.flatnonzero(np.repeat(mixed, per_pixel))
        part_nodes, part_weights = self.mesh.interpolate(self._paint(points.surface[parts]), points.uv[:, parts])
        part_weights *= points.gain[parts, None] / per_pixel
        pixels = np.concatenate([np.flatnonzero(single), np.repeat(detailed[mixed], per_pixel)])
        return sparse_matrix(
            pixels,
            self.stand_in[np.concatenate([nodes, part_nodes])],
            np.concatenate([weights, part_weights]),
            (count, self.mesh.count),
        )


def samples_per_pixel(camera: PlacedDevice, projector: PlacedDevice) -> int:
    """Samples across a camera pixel, so that neighbouring samples are about half a projector pixel apart."""
    ratio = projector.optics.focal_px / camera.optics.focal_px
    return int(np.clip(np.ceil(2 * ratio), 2, 8))


def _pixel_centres(rows: range, width: int) -> Floats:
    """All pixels of some rows, (2, pixels)."""
    x, y = np.meshgrid(np.arange(width), np.arange(rows.start, rows.stop))
    return np.stack([x.ravel(), y.ravel()]).astype(np.float64)
