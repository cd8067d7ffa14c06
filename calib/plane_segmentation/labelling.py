"""Assign every match to a known plane near it if it fits that plane and no other."""

import cv2
import numpy as np

from calib.geometry import Matches, rescaled_point
from calib.numerics import Floats, Ints, compiled, in_pieces
from calib.plane_segmentation.plane_parallax import Lens
from calib.plane_segmentation.segmentation import Segments
from calib.plane_segmentation.surfels import Surfels

_GATE = 3.7  # in sigmas: a 2-D normal error exceeds it once in 940
# A match that two planes explain is assigned to neither unless one is e^4.5 times as likely.
_CLEARER_BY = 9.0
_SAMPLE = 100_000
_BLOCK = 512  # matches whose numbers fit into the processor's cache

# The arguments of `rescaled_point` behind the pixel.
_Device = tuple[float, float, float, Floats]


def label_matches(
    matches: Matches, surfels: Surfels, segments: Segments, rng: np.random.Generator
) -> tuple[Ints, Ints]:
    """Return the plane of each match (N,) and the number of matches on each plane (n,).

    A match can be on a plane of its own surfel or of a neighbouring one if it fits within the noise; n, the number of
    planes, means none.
    """
    view, homographies = segments.view, segments.view.homography(segments.planes)
    candidates, near = _near(surfels, segments.label, len(homographies))
    cell_sigma, scale = _cell_sigma(surfels), _scale(matches, surfels, rng)
    plane = np.empty(len(matches), np.int32)
    camera, projector = _numbers_of(view.camera), _numbers_of(view.projector)

    def label(at: slice) -> Ints:
        camera_px, counts = np.ascontiguousarray(matches.camera_px[at]), np.zeros(len(homographies), np.int64)
        cell = surfels.grid.cell(camera_px)
        sigma = cell_sigma.take(cell) if matches.sigma_px is None else scale * matches.sigma_px[at].astype(np.float64)
        _label(
            camera_px,
            np.ascontiguousarray(matches.projector_px[at]),
            camera,
            projector,
            near.take(cell),
            sigma,
            segments.model_px,
            homographies,
            candidates,
            plane[at],
            counts,
        )
        return counts

    counts: Ints = np.sum(in_pieces(len(matches), label), axis=0)
    return plane, counts


def _numbers_of(lens: Lens) -> _Device:
    return *lens.centre_px, 1 / lens.unit_px, lens.parameters


def _near(surfels: Surfels, label: Ints, planes: int) -> tuple[Ints, Ints]:
    """Return the sets of planes that occur in or next to a cell, (sets, n), padded with n, and each cell's (cells,)."""
    grid = surfels.grid
    image = np.zeros((planes, grid.rows * grid.columns), np.uint8)
    on_plane = label >= 0
    image[label[on_plane], surfels.cell[on_plane]] = 1
    kernel = np.ones((3, 3), np.uint8)
    dilated = np.stack([cv2.dilate(channel.reshape(grid.rows, grid.columns), kernel).ravel() for channel in image])
    _, first, near = np.unique((1 << np.arange(planes)) @ dilated, return_index=True, return_inverse=True)
    sets = np.where(dilated[:, first].T > 0, np.arange(planes, dtype=np.int32), np.int32(planes))
    return np.sort(sets, axis=1), near.astype(np.int32)


def _cell_sigma(surfels: Surfels) -> Floats:
    """Return the scatter of a match in each cell, in pixels; the typical one where a cell has no surfel."""
    usual = np.median(surfels.sigma_px)
    sigma = np.full(surfels.grid.rows * surfels.grid.columns, usual)
    # A cell that straddles an edge looks noisier than it is.
    sigma[surfels.cell] = np.minimum(surfels.sigma_px, 3 * usual)
    return sigma


def _scale(matches: Matches, surfels: Surfels, rng: np.random.Generator) -> float:
    """Return the ratio of the scatter of matches to their stated sigmas."""
    sigma = matches.sigma_px
    if sigma is None:
        return 1.0
    if len(sigma) > _SAMPLE:
        sigma = sigma[rng.integers(0, len(sigma), _SAMPLE)]
    return float(np.median(surfels.sigma_px) / np.median(sigma))


@compiled
def _label(
    camera_px: Floats,
    projector_px: Floats,
    camera: _Device,
    projector: _Device,
    near: Ints,
    sigma_px: Floats,
    model_px: float,
    homographies: Floats,
    candidates: Ints,
    plane: Ints,
    counts: Ints,
) -> None:
    """Pixels (N, 2) of both devices → `plane` (N,), and how often each of the n occurs, (n,).

    Matches are in image order: long runs have the same `near` (N,), a row of `candidates`, and are vectorised.
    """
    none, per_unit, end = len(homographies), 1.0 / (projector[2] * projector[2]), 0
    x, y, u, v, per_variance, best, second = np.empty((7, _BLOCK))
    labels = np.empty(_BLOCK, np.int32)
    while end < len(plane):
        start, run = end, near[end]
        while end < min(start + _BLOCK, len(plane)) and near[end] == run:
            end += 1
        pixels, lit, sigma, own = camera_px[start:end], projector_px[start:end], sigma_px[start:end], plane[start:end]
        _rescale(pixels, camera, x, y)
        _rescale(lit, projector, u, v)
        for i in range(len(own)):
            per_variance[i] = per_unit / (sigma[i] * sigma[i] + model_px * model_px)
        best[:], second[:], labels[:] = np.inf, np.inf, none
        for candidate in candidates[run]:
            if candidate == none:
                break
            (h00, h01, h02), (h10, h11, h12), (h20, h21, h22) = homographies[candidate]
            for i in range(len(own)):
                per_third = 1.0 / (h20 * x[i] + h21 * y[i] + h22)
                off_x = (h00 * x[i] + h01 * y[i] + h02) * per_third - u[i]
                off_y = (h10 * x[i] + h11 * y[i] + h12) * per_third - v[i]
                error = (off_x * off_x + off_y * off_y) * per_variance[i]
                # Everything is read before a choice: reads that depend on one are not vectorised.
                least, next_least, last = best[i], second[i], labels[i]
                nearer = error < least
                runner_up = least if nearer else error
                second[i] = runner_up if runner_up < next_least else next_least
                best[i], labels[i] = (error, candidate) if nearer else (least, last)
        for i in range(len(own)):
            clear = (best[i] <= _GATE * _GATE) & (second[i] >= best[i] + _CLEARER_BY)
            own[i] = labels[i] if clear else none
        for candidate in candidates[run]:
            if candidate == none:
                break
            counts[candidate] += np.sum(own == candidate)


@compiled
def _rescale(pixels: Floats, device: _Device, x: Floats, y: Floats) -> None:
    """Ideal coordinates of pixels (N, 2), into the beginning of `x` and `y`."""
    for i in range(len(pixels)):
        x[i], y[i] = rescaled_point(pixels[i, 0], pixels[i, 1], *device)
