"""What surfels say about planes, once the epipolar geometry is known: a parallax, and how it slopes in the image."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints
from calib.plane_segmentation.plane_parallax import TwoView
from calib.plane_segmentation.surfels import Surfels


@dataclass(frozen=True)
class Evidence:
    """What each surfel says about the plane v (3,) it lies on, in units of its own standard deviations.

    `rows` (12, M): three times a number, and the three of which v should make it: first the parallax, then its slope
    along both axes of the camera. `sigma` (M,): of the parallax, in projector pixels. `across` (M,): distance from the
    epipolar line over `sigma`.
    """

    rows: Floats
    sigma: Floats
    across: Floats

    def off(self, planes: Floats, number: int = 0) -> Floats:
        """How far one of the three numbers is from what planes (n, 3) make it, (n, M)."""
        off: Floats = self.rows[4 * number] - planes @ self.rows[4 * number + 1 : 4 * number + 4]
        return off

    def off_own(self, planes: Floats, label: Ints) -> Floats:
        """How far the parallax is from that of the plane that `label` (M,) names, (M,)."""
        off: Floats = self.rows[0] - np.einsum("im,mi->m", self.rows[1:4], planes[label])
        return off


def gather_evidence(surfels: Surfels, view: TwoView, model_px: float) -> Evidence:
    """`model_px`: standard deviation of what the lens model and the decoder's systematic errors leave."""
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
        # A model error that varies over the width of some cells has a slope, too.
        slope_sigma = np.sqrt(variance + (model_px / (4 * step)) ** 2)
        slope = rows[4 + 4 * axis : 8 + 4 * axis]
        slope[0], slope[1:] = ahead.value - behind.value, (ahead.x - behind.x).T
        slope /= 2 * step * here.per_px * slope_sigma
    return Evidence(rows, sigma, here.across_px / sigma)
