"""Observations of planes by surfels, given the epipolar geometry: a parallax and its gradient in the image."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints
from calib.plane_segmentation.plane_parallax import TwoView
from calib.plane_segmentation.surfels import Surfels


@dataclass(frozen=True)
class Evidence:
    """Linear equations of each surfel for the plane v (3,) it lies on, in units of their standard deviations.

    `rows` (12, M): three equations, each a right-hand side followed by the three coefficients of v: first for the
    parallax, then for its slopes along both camera axes. `sigma` (M,): of the parallax, in projector pixels. `across`
    (M,): distance from the epipolar line over `sigma`.
    """

    rows: Floats
    sigma: Floats
    across: Floats

    def off(self, planes: Floats, number: int = 0) -> Floats:
        """Return the residual of one of the three equations for planes (n, 3), (n, M)."""
        off: Floats = self.rows[4 * number] - planes @ self.rows[4 * number + 1 : 4 * number + 4]
        return off

    def off_own(self, planes: Floats, label: Ints) -> Floats:
        """Return the residual (M,) of the parallax for each surfel's own plane, given by `label` (M,)."""
        off: Floats = self.rows[0] - np.einsum("im,mi->m", self.rows[1:4], planes[label])
        return off


def gather_evidence(surfels: Surfels, view: TwoView, model_px: float) -> Evidence:
    """Gather the equations; `model_px`: standard deviation of errors of the lens model and the decoder."""
    step = surfels.grid.side_px / 2
    here = view.parallax(surfels.camera_px, surfels.projector_px)
    sigma = np.hypot(surfels.sigma_px / np.sqrt(surfels.count), model_px)
    rows = np.empty((12, len(surfels)))
    rows[0], rows[1:4] = here.value, here.x.T
    rows[:4] /= here.per_px * sigma
    spread = surfels.spread
    determinant = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] ** 2
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        moved = surfels.jacobian @ shift
        ahead = view.parallax(surfels.camera_px + shift, surfels.projector_px + moved)
        behind = view.parallax(surfels.camera_px - shift, surfels.projector_px - moved)
        variance = spread[:, 1 - axis, 1 - axis] / determinant * surfels.sigma_px**2
        # A model error that varies over a few cells also has a slope.
        slope_sigma = np.sqrt(variance + (model_px / (4 * step)) ** 2)
        slope = rows[4 + 4 * axis : 8 + 4 * axis]
        slope[0], slope[1:] = ahead.value - behind.value, (ahead.x - behind.x).T
        slope /= 2 * step * here.per_px * slope_sigma
    return Evidence(rows, sigma, here.across_px / sigma)
