"""Matches over one device's image: where others see the light of its pixels, or light what they see, on a grid.

What several devices share is told in the image of the one that they share: a projector's pixel lights one point,
whichever camera sees it, and a camera's pixel sees one point, whichever projector lights it. So other pairs tell which
plane of the room a match is on.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.geometry import NO_FACE, Size, nearest_depths, project, unproject
from calib.networks.network import Device
from calib.numerics import MEDIAN_LENGTH, Bools, Floats, Ints, median

_MATCHES_PER_CELL = 3
_LARGEST_CELL = 16  # pixels
_JUMP = 0.5  # of a cell's width: further off the neighbours' line is another surface
_STEPS = 3


@dataclass(frozen=True, eq=False)
class ImageRaster:
    """Square cells of `cell` pixels over an image, `height` × `width` of them."""

    cell: int
    height: int
    width: int

    @classmethod
    def fine(cls, size: Size, pixels: Iterable[Floats]) -> "ImageRaster":
        """With some in each cell of every list of pixels (N, 2)."""
        cell = max(_cell_of(pixel, size) for pixel in pixels)
        return cls(cell, size.height // cell, size.width // cell)

    @cached_property
    def centres(self) -> Floats:
        """Pixels at the cells' centres, (h, w, 2)."""
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return (np.stack([x, y], axis=-1) * self.cell + (self.cell - 1) / 2).astype(np.float64)

    def numbers(self, pixels: Floats) -> tuple[Ints, Bools]:
        """Numbers of the cells of those pixels that are in one, and which (N,) these are."""
        column, row = np.floor((pixels + 0.5) / self.cell).astype(np.int64).T
        inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
        flat: Ints = (row * self.width + column)[inside]
        return flat, inside


def _cell_of(pixels: Floats, size: Size) -> int:
    for cell in range(1, _LARGEST_CELL):
        flat, _ = ImageRaster(cell, size.height // cell, size.width // cell).numbers(pixels)
        count = np.bincount(flat, minlength=1)
        if np.median(count[count > 0]) >= _MATCHES_PER_CELL:
            return cell
    return _LARGEST_CELL


@dataclass(frozen=True, eq=False)
class SeenAt:
    """Pixels of another device at a raster's centres; NaN where neighbours are missing, or on another surface."""

    pixels: Floats
    """(h, w, 2)."""
    by_own: Floats
    """Their derivatives by the raster's pixels, (h, w, 2, 2)."""
    count: Ints
    """Number of matches, (h, w)."""
    noise_px: float
    """Of a match, in the other's pixels, by how far cells are off the mean of their neighbours."""

    @classmethod
    def of(cls, raster: ImageRaster, own: Floats, partner: Floats) -> "SeenAt":
        """From matches of pixels (N, 2) of the raster's device with the other's."""
        shape, cell = (raster.height, raster.width), raster.cell
        flat, inside = raster.numbers(own)
        count = np.bincount(flat, minlength=shape[0] * shape[1])

        def mean(values: Floats) -> Floats:
            sums = [np.bincount(flat, column[inside], minlength=len(count)) for column in values.T]
            with np.errstate(invalid="ignore", divide="ignore"):
                return (np.stack(sums, axis=1) / count[:, None]).reshape(*shape, 2)

        there, here = mean(partner), mean(own)
        across, moved = np.full((*shape, 2, 2), np.nan), np.full((*shape, 2, 2), np.nan)
        for axis in (0, 1):  # along x, along y
            after, before = ((slice(None), slice(2, None)), (slice(None), slice(None, -2)))
            middle = (slice(None), slice(1, -1))
            if axis:
                after, before, middle = after[::-1], before[::-1], middle[::-1]
            moved[middle][..., axis] = there[after] - there[before]
            across[middle][..., axis] = here[after] - here[before]
        determinant = across[..., 0, 0] * across[..., 1, 1] - across[..., 0, 1] * across[..., 1, 0]
        singular = ~(np.abs(determinant) > 0.1 * cell**2)
        across[singular] = np.eye(2)
        by_own = moved @ np.linalg.inv(across)
        by_own[singular] = np.nan
        pixels = there - np.einsum("hwij,hwj->hwi", by_own, here - raster.centres)
        # The mean of the four neighbours is where the cell itself is, unless a surface ends between them.
        around = np.full_like(pixels, np.nan)
        around[1:-1, 1:-1] = (pixels[:-2, 1:-1] + pixels[2:, 1:-1] + pixels[1:-1, :-2] + pixels[1:-1, 2:]) / 4
        width = cell * np.sqrt(np.abs(np.linalg.det(np.nan_to_num(by_own))))
        off = np.linalg.norm(pixels - around, axis=-1)
        jumps = ~(off < _JUMP * width)
        pixels[jumps] = np.nan
        number = count.reshape(shape)
        # A cell's mean and that of four neighbours differ by 5/4 of a cell's variance.
        scatter = (off * np.sqrt(number * 4 / 5))[~jumps]
        return cls(pixels, by_own, number, median(scatter) / MEDIAN_LENGTH if len(scatter) else np.nan)


def depths(own: Device, partner: Device, centres: Floats, sighting: SeenAt) -> tuple[Floats, Floats]:
    """Along a device's rays through pixels (h, w, 2), in multiples of rays of z = 1, as another one has it, (h, w).

    And its derivatives (h, w, 2) by the other's pixels. NaN where it sees nothing. The depth is where the point is seen
    nearest to the other's pixel.
    """
    shape = centres.shape[:2]
    depth, by_px = np.full(shape, np.nan), np.full((*shape, 2), np.nan)
    at = np.isfinite(sighting.pixels).all(axis=-1)
    if not at.any():
        return depth, by_px
    pixels = sighting.pixels[at]
    rays, to_partner = own.pose.rotate(unproject(own.lens, centres[at])[0]), partner.pose.inverse()
    back, _ = unproject(partner.lens, pixels)
    apart = own.pose.translation - partner.pose.translation
    nearest = nearest_depths(rays, partner.pose.rotate(back), apart)[0]
    turned, beside = to_partner.rotate(rays), to_partner.rotate(apart)
    for _ in range(_STEPS):
        predicted, by_point, _ = project(partner.lens, nearest[:, None] * turned + beside)
        along = np.einsum("nij,nj->ni", by_point, turned)
        square = np.sum(along**2, axis=1)
        nearest = nearest + np.sum(along * (pixels - predicted), axis=1) / square
    good = nearest > 0
    depth[at] = np.where(good, nearest, np.nan)
    by_px[at] = np.where(good[:, None], along / square[:, None], np.nan)
    return depth, by_px


_SURROUNDED = 4  # of eight neighbours with the same label; where a plane ends beside a cell nothing is told


def label_map(raster: ImageRaster, labelled: Iterable[tuple[Floats, Ints]]) -> Ints:
    """Labels (h, w) of a raster's cells from pixels (N, 2) and their labels (N,) of several pairs.

    NO_FACE where none is near, where labels differ in a cell or beside it, and at the rim of what is labelled.
    """
    shape = (raster.height, raster.width)
    low, high = np.full(shape[0] * shape[1], np.iinfo(np.int32).max, np.int32), np.full(shape[0] * shape[1], NO_FACE)
    for pixels, labels in labelled:
        known = labels != NO_FACE
        flat, inside = raster.numbers(pixels[known])
        own = labels[known][inside]
        np.minimum.at(low, flat, own)
        np.maximum.at(high, flat, own)
    label = high.reshape(shape)
    padded = np.pad(np.where(high > low, -2, high).reshape(shape), 1, constant_values=NO_FACE)
    around = [
        padded[1 + y : 1 + y + shape[0], 1 + x : 1 + x + shape[1]]
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
        if (x, y) != (0, 0)
    ]
    same, none = (sum((neighbour == value).astype(np.int8) for neighbour in around) for value in (label, NO_FACE))
    certain = (padded[1:-1, 1:-1] >= 0) & (same >= _SURROUNDED) & (same + none == len(around))
    return np.where(certain, label, NO_FACE).astype(np.int32)


def read(raster: ImageRaster, certain: Ints, pixels: Floats) -> Ints:
    """Labels (N,) of pixels (N, 2) from those of cells (h, w)."""
    flat, inside = raster.numbers(pixels)
    labels = np.full(len(pixels), NO_FACE, np.int32)
    labels[inside] = certain.ravel()[flat]
    return labels
