"""Starting states for the refinement of two photos: the paper's transfer has to return the camera it began with.

For photos by one camera the transfer of intrinsics through the corner has to be the identity. So the paper's objective
(its equation 13) becomes E(f, x_0, y_0) = |γ'| + |f_x' − f| + |f_y' − f| + |x_0' − x_0| +
|y_0' − y_0| for the transferred camera (f_x', f_y', γ', x_0', y_0'), and the principal point need not be known. The
focal length is swept as for a rig; at each trial E selects the principal point from a grid.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.closed_form import Objective, objective_for
from calib.geometry import Pose
from calib.numerics import Floats
from calib.refinement.distortion_from_planes import Straightened, straighten
from calib.refinement.likelihood import Knowledge
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import PlacedCorner, State, without_lens

_GRID = (-0.2, -0.1, 0.0, 0.1, 0.2)  # principal points to try, in image widths off the expected one
_STARTS = 1  # principal points to start from, for each focal and each of the two corners


@dataclass(frozen=True)
class PhotoFamily:
    """Starts for one pair of photos, from `straightened` matches; `points_px` (P, 2): principal points to try."""

    objective: Objective
    straightened: Straightened
    points_px: Floats

    def starts(self, focal_px: Floats) -> list[list[State]]:
        """Return for each focal (n,) the states with the smallest difference between both photos' cameras."""
        count = len(focal_px)
        costs = np.full((len(self.points_px), 2 * count), np.inf)
        states: dict[tuple[int, int], State] = {}
        for p, point in enumerate(self.points_px):
            objective = replace(self.objective, principal_point_px=(float(point[0]), float(point[1])))
            transfers, in_front = objective.forward(focal_px, nearest=True)
            usable = in_front & np.isfinite(transfers.matrix).all(axis=(1, 2))
            focals = np.concatenate([focal_px, focal_px])
            costs[p] = np.where(usable, objective_of_photos(transfers.matrix, focals, point), np.inf)
            for i in np.flatnonzero(usable):
                camera = without_lens(focals[i], point, self._bend * focals[i] ** 2)
                baseline = np.linalg.norm(transfers.translation[i])
                states[p, int(i)] = State(
                    camera,
                    camera,
                    Pose(transfers.rotation[i], transfers.translation[i] / baseline),
                    np.zeros((1, 3)),
                    (PlacedCorner(transfers.normals[i], transfers.vertex[i] / baseline),),
                    one_camera=True,
                )
        nearest = np.argsort(costs, axis=0)[:_STARTS]
        return [
            [states[p, i] for i in (trial, count + trial) for p in map(int, nearest[:, i]) if (p, i) in states]
            for trial in range(count)
        ]

    @property
    def _bend(self) -> float:
        return (self.straightened.camera_bend + self.straightened.projector_bend) / 2


def objective_of_photos(matrices: Floats, focal_px: Floats, point_px: Floats) -> Floats:
    """E (n,) in pixels of transferred matrices (n, 3, 3) for trial focals (n,) and one principal point (2,)."""
    off: Floats = (
        np.abs(matrices[:, 0, 1]) + np.abs(matrices[:, 0, 0] - focal_px) + np.abs(matrices[:, 1, 1] - focal_px)
    )
    apart: Floats = np.sum(np.abs(matrices[:, :2, 2] - point_px), axis=1)
    return off + apart


def photo_family(cells: Cells, knowledge: Knowledge) -> PhotoFamily:
    """Prepare the family for one pair of photos. Raises TooFewMatchesError if a face has fewer than four cells."""
    centre = knowledge.principal_point_px
    straightened = straighten(cells, centre, centre)
    known = knowledge.principal_point_sigma_px == 0
    offsets = [(0.0, 0.0)] if known else list(product(_GRID, _GRID))
    points = np.array(centre) + knowledge.camera_size[0] * np.array(offsets)
    return PhotoFamily(objective_for(straightened.matches, centre), straightened, points)
