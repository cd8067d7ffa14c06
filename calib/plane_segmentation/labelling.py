"""Assign every match to a known plane near it if it fits that plane and no other."""

import cv2
import numpy as np

from calib.geometry import Matches
from calib.geometry.radial_distortion import rescaled_point
from calib.numerics import Floats, Ints, compiled, in_pieces
from calib.plane_segmentation.plane_parallax import Lens
from calib.plane_segmentation.segmentation import Segments
from calib.plane_segmentation.surfels import Surfels

_GATE = 3.7  # in sigmas: a 2-D normal error exceeds it once in 940
# A match that two planes explain is assigned to neither unless one is e^4.5 times as likely.
_CLEARER_BY = 9.0
_SAMPLE = 100_000

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
    near = _near(surfels, segments.label, len(homographies))
    cell_sigma, scale = _cell_sigma(surfels), _scale(matches, surfels, rng)
    plane = np.empty(len(matches), np.int32)
    camera, projector = _numbers_of(view.camera), _numbers_of(view.projector)

    def label(at: slice) -> Ints:
        camera_px, counts = np.ascontiguousarray(matches.camera_px[at]), np.zeros(len(homographies) + 1, np.int64)
        cell = surfels.grid.cell(camera_px)
        sigma = cell_sigma.take(cell) if matches.sigma_px is None else scale * matches.sigma_px[at].astype(np.float64)
        _label(
            camera_px,
            np.ascontiguousarray(matches.projector_px[at]),
            camera,
            projector,
            cell,
            sigma,
            segments.model_px,
            homographies,
            near,
            plane[at],
            counts,
        )
        return counts[:-1]

    counts: Ints = np.sum(in_pieces(len(matches), label), axis=0)
    return plane, counts


def _numbers_of(lens: Lens) -> _Device:
    return *lens.centre_px, 1 / lens.unit_px, lens.parameters


def _near(surfels: Surfels, label: Ints, planes: int) -> Ints:
    """Return the planes in or next to each cell, (cells, n), padded with n."""
    grid = surfels.grid
    image = np.zeros((planes, grid.rows * grid.columns), np.uint8)
    on_plane = label >= 0
    image[label[on_plane], surfels.cell[on_plane]] = 1
    kernel = np.ones((3, 3), np.uint8)
    dilated = np.stack([cv2.dilate(one.reshape(grid.rows, grid.columns), kernel).ravel() for one in image], axis=1)
    near: Ints = np.sort(np.where(dilated > 0, np.arange(planes, dtype=np.int32), np.int32(planes)), axis=1)
    return near


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
    cell: Ints,
    sigma_px: Floats,
    model_px: float,
    homographies: Floats,
    near: Ints,
    plane: Ints,
    counts: Ints,
) -> None:
    """Pixels (N, 2) of both devices → `plane` (N,), and how often each occurs, (n + 1,)."""
    h, none, unit_px = homographies, len(homographies), 1.0 / projector[2]
    for i in range(len(plane)):
        c = cell[i]
        x0, x1 = rescaled_point(camera_px[i, 0], camera_px[i, 1], *camera)
        u0, u1 = rescaled_point(projector_px[i, 0], projector_px[i, 1], *projector)
        per_variance = unit_px * unit_px / (sigma_px[i] * sigma_px[i] + model_px * model_px)
        best, second, found = np.inf, np.inf, none
        for candidate in range(none):
            p = near[c, candidate]
            if p == none:
                break
            per_third = 1.0 / (h[p, 2, 0] * x0 + h[p, 2, 1] * x1 + h[p, 2, 2])
            off0 = (h[p, 0, 0] * x0 + h[p, 0, 1] * x1 + h[p, 0, 2]) * per_third - u0
            off1 = (h[p, 1, 0] * x0 + h[p, 1, 1] * x1 + h[p, 1, 2]) * per_third - u1
            error = (off0 * off0 + off1 * off1) * per_variance
            if error < best:
                best, second, found = error, best, p
            elif error < second:
                second = error
        if best > _GATE * _GATE or second < best + _CLEARER_BY:
            found = none
        plane[i] = found
        counts[found] += 1
