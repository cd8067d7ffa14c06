"""Surfaces from all rays: where each projector's pixels fell, by all cameras that saw them.

A projector's ray is one line in the room, whichever camera sees its light. Each camera tells how far along it the
surface is, with a variance; the weighted mean of these is what all of them say, and their differences are the honest
test of a network, for nothing else ties cameras so directly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.geometry import Matches, Size, nearest_depths, project, unproject
from calib.networks.estimate import NetworkEstimate
from calib.networks.network import Device
from calib.numerics import SIGMA_PER_MEDIAN, Bools, Floats, Ints

_MATCHES_PER_CELL = 3
_LARGEST_CELL = 16  # projector pixels
_JUMP = 0.5  # of a cell's width: further off the neighbours' line is another surface
_STEPS = 3
_LEAST_SHARED = 50


@dataclass(frozen=True, eq=False)
class Joined:
    """Of one projector's light, on a grid (h, w) of cells of its image; NaN for none.

    `points` (h, w, 3) in the room's frame, `sigma` (h, w) along the projector's ray by the matches' noise, `best_sigma`
    the same of the best camera alone, `cameras` (h, w) how many saw it. `seen_px`: by camera, where in its image
    (h, w, 2). `disagreements`: of each two cameras.
    """

    points: Floats
    sigma: Floats
    best_sigma: Floats
    cameras: Ints
    seen_px: Mapping[str, Floats]
    disagreements: tuple["Disagreement", ...]

    @property
    def gain(self) -> float:
        """By what factor sigma is smaller than the best camera's, median where several saw a point; NaN of none."""
        several = self.cameras > 1
        return float(np.median((self.best_sigma / self.sigma)[several])) if several.any() else float("nan")


@dataclass(frozen=True)
class Disagreement:
    """Two cameras' depths in one projector's light: median difference, relative to the depth, what the noise of matches
    alone would make of it, and the number of cells that both saw.
    """

    first: str
    second: str
    relative: float
    expected: float
    count: int


def joined(estimate: NetworkEstimate, projector: str, by_camera: Mapping[str, Matches]) -> Joined:
    """All cameras' matches with one projector, (N,) each."""
    size, device = estimate.sizes[projector], estimate.device(projector)
    cell = max(_cell_of(matches, size) for matches in by_camera.values())
    height, width = size.height // cell, size.width // cell
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    centres = (np.stack([x, y], axis=-1) * cell + (cell - 1) / 2).astype(np.float64)
    rays, _ = unproject(device.lens, centres.reshape(-1, 2))
    rays = rays @ device.pose.rotation.T
    seen: dict[str, Floats] = {}
    depths: list[Floats] = []
    variances: list[Floats] = []
    chances: list[Floats] = []
    for camera, matches in by_camera.items():
        pixels, by_cell, count = _at_centres(matches, cell, centres)
        noise = estimate.noise[camera, projector]
        depth, by_px = _depths(estimate.device(camera), device, rays, pixels, by_cell)
        by_chance = by_px**2 * noise.match_px**2 / np.maximum(count.ravel(), 1)
        seen[camera] = pixels
        depths.append(depth)
        chances.append(by_chance)
        variances.append(by_chance + by_px**2 * noise.systematic_px**2)
    depth, variance = np.stack(depths), np.stack(variances)
    weight = np.where(np.isfinite(depth), 1 / variance, 0.0)
    total = weight.sum(axis=0)
    there = total > 0
    safe = np.where(there, total, 1.0)
    mean = np.where(there, np.nansum(weight * np.nan_to_num(depth), axis=0) / safe, np.nan)
    points = (device.pose.translation + mean[:, None] * rays).reshape(height, width, 3)
    sigma = np.where(there, safe**-0.5, np.nan).reshape(height, width)
    best = np.where(there, np.where(weight > 0, weight, 0).max(axis=0, initial=1e-300) ** -0.5, np.nan)
    return Joined(
        points,
        sigma,
        best.reshape(height, width),
        np.count_nonzero(weight, axis=0).reshape(height, width),
        seen,
        tuple(_disagreements(tuple(by_camera), depth, np.stack(chances))),
    )


def _cell_of(matches: Matches, size: Size) -> int:
    """Width in projector pixels of cells that have some matches each."""
    for cell in range(1, _LARGEST_CELL):
        flat = _flat(matches, cell, size.width // cell, size.height // cell)[0]
        count = np.bincount(flat)
        if np.median(count[count > 0]) >= _MATCHES_PER_CELL:
            return cell
    return _LARGEST_CELL


def _flat(matches: Matches, cell: int, width: int, height: int) -> tuple[Ints, Bools]:
    """Numbers of the cells of those matches that are in one, and which (N,) these are."""
    column, row = np.floor((matches.projector_px + 0.5) / cell).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    flat: Ints = (row * width + column)[inside]
    return flat, inside


def _at_centres(matches: Matches, cell: int, centres: Floats) -> tuple[Floats, Floats, Ints]:
    """Camera pixels (h, w, 2) that see the cells' centres, their derivatives (h, w, 2, 2) by projector pixels, and
    matches (h, w) in each. NaN where neighbours are missing, or on another surface.
    """
    height, width, _ = centres.shape
    flat, inside = _flat(matches, cell, width, height)
    count = np.bincount(flat, minlength=height * width)

    def mean(values: Floats) -> Floats:
        sums = [np.bincount(flat, column[inside], minlength=height * width) for column in values.T]
        with np.errstate(invalid="ignore", divide="ignore"):
            return (np.stack(sums, axis=1) / count[:, None]).reshape(height, width, 2)

    camera, projector = mean(matches.camera_px), mean(matches.projector_px)
    across = np.full((height, width, 2, 2), np.nan)
    moved = np.full((height, width, 2, 2), np.nan)
    for axis in (0, 1):  # along x, along y
        after, before = ((slice(None), slice(2, None)), (slice(None), slice(None, -2)))
        middle = (slice(None), slice(1, -1))
        if axis:
            after, before, middle = after[::-1], before[::-1], middle[::-1]
        moved[middle][..., axis] = camera[after] - camera[before]
        across[middle][..., axis] = projector[after] - projector[before]
    determinant = across[..., 0, 0] * across[..., 1, 1] - across[..., 0, 1] * across[..., 1, 0]
    singular = ~(np.abs(determinant) > 0.1 * cell**2)
    across[singular] = np.eye(2)
    by_cell = moved @ np.linalg.inv(across)
    by_cell[singular] = np.nan
    at_centre = camera - np.einsum("hwij,hwj->hwi", by_cell, projector - centres)
    # The mean of the four neighbours is where the cell itself is, unless a surface ends between them.
    around = np.full_like(at_centre, np.nan)
    around[1:-1, 1:-1] = (at_centre[:-2, 1:-1] + at_centre[2:, 1:-1] + at_centre[1:-1, :-2] + at_centre[1:-1, 2:]) / 4
    size = cell * np.sqrt(np.abs(np.linalg.det(np.nan_to_num(by_cell))))
    jumps = ~(np.linalg.norm(at_centre - around, axis=-1) < _JUMP * size)
    at_centre[jumps] = np.nan
    return at_centre, by_cell, count.reshape(height, width)


def _depths(camera: Device, projector: Device, rays: Floats, pixels: Floats, by_cell: Floats) -> tuple[Floats, Floats]:
    """Along the projector's rays (N, 3), as one camera has it, and by how much a projector pixel moves it, (N,) each;
    NaN where it sees nothing.

    The depth is where the point is seen nearest to the pixel; `by_cell` carries errors of matches there.
    """
    depth, by_px = np.full(len(rays), np.nan), np.full(len(rays), np.nan)
    at = np.flatnonzero(np.isfinite(pixels.reshape(-1, 2)).all(axis=1))
    if not len(at):
        return depth, by_px
    seen, own = pixels.reshape(-1, 2)[at], rays[at]
    back, _ = unproject(camera.lens, seen)
    apart = projector.pose.translation - camera.pose.translation
    found = nearest_depths(own, back @ camera.pose.rotation.T, apart)[0]
    turned = own @ camera.pose.rotation
    for _ in range(_STEPS):
        predicted, by_point, _ = project(camera.lens, found[:, None] * turned + apart @ camera.pose.rotation)
        along = np.einsum("nij,nj->ni", by_point, turned)
        square = np.sum(along**2, axis=1)
        found = found + np.sum(along * (seen - predicted), axis=1) / square
    carried = np.einsum("nij,ni->nj", by_cell.reshape(-1, 2, 2)[at], along / square[:, None])
    good = found > 0
    depth[at[good]] = found[good]
    by_px[at[good]] = np.linalg.norm(carried, axis=1)[good]
    return depth, by_px


def _disagreements(names: tuple[str, ...], depth: Floats, variance: Floats) -> list[Disagreement]:
    found = []
    for i, j in combinations(range(len(names)), 2):
        both = np.isfinite(depth[i]) & np.isfinite(depth[j])
        if np.count_nonzero(both) < _LEAST_SHARED:
            continue
        mean = (depth[i, both] + depth[j, both]) / 2
        off = float(np.median(np.abs(depth[i, both] - depth[j, both]) / mean))
        sigma = np.sqrt(variance[i, both] + variance[j, both]) / mean
        found.append(Disagreement(names[i], names[j], off, float(np.median(sigma)) / SIGMA_PER_MEDIAN, int(both.sum())))
    return found
