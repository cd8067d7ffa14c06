"""The published method: one unknown, the camera's focal length, and an objective of seven terms (section 4).

Kept as published, for comparison and as the start of the refinement: camera principal point known, no lens terms,
exactly square corner.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from calib.closed_form.transfer import Transfer, image_of_corner, intrinsic_matrices, transfer
from calib.geometry import FACES, CornerImage, FaceGrams, Matches, face_grams, homogeneous
from calib.numerics import Bools, Floats

_POINTS_IN_FRONT = 0.99
_SAMPLE_PER_FACE = 200
_BRACKETS, _PROMISING = 3, 2.0


@dataclass(frozen=True)
class Objective:
    """E(f_c): equations 13 and 14, evaluated for many focals at once.

    `sample`: homogeneous camera points (N, 3) of each face that must lie in front of both devices.
    """

    grams: FaceGrams
    camera_image: CornerImage
    projector_image: CornerImage
    principal_point_px: tuple[float, float]
    sample: tuple[Floats, ...]

    def evaluate(self, focal_px: Floats) -> tuple[Floats, Transfer]:
        """Focals (n,) → E (2, n) in pixels, for both solutions of the corner, and the 2n transfers.

        Infinite where there is no solution or points would lie behind a device.
        """
        forward, in_front = self.forward(focal_px)
        terms = self.terms(focal_px, forward)
        total: Floats = np.sum(terms, axis=0)
        total[~np.isfinite(total) | ~in_front] = np.inf
        return total.reshape(2, len(focal_px)), forward

    def forward(self, focal_px: Floats, *, nearest: bool = False) -> tuple[Transfer, Bools]:
        """Focals (n,) → the 2n transfers to the projector, and a mask (2n,): sample in front of both devices.

        `nearest`: as in `transfer`.
        """
        matrices = intrinsic_matrices(focal_px, self.principal_point_px)
        forward = transfer(self.grams, self.camera_image, matrices, nearest=nearest)
        in_front: Bools = forward.in_front(self.sample) >= _POINTS_IN_FRONT
        return forward, in_front

    def terms(self, focal_px: Floats, forward: Transfer) -> Floats:
        """The seven terms E_1 … E_7 (7, 2n) of equation 14.

        The backward transfer uses the projector of equation 11: one focal length and a principal point. With skew and
        two focals, every trial would lead back to its camera and the cycle would carry no information.
        """
        focal = np.concatenate([focal_px, focal_px])
        pro = forward.matrix
        finite: Bools = np.all(np.isfinite(pro), axis=(1, 2))
        trial = np.where(finite[:, None, None], pro, np.eye(3))
        natural = intrinsic_matrices((trial[:, 0, 0] + trial[:, 1, 1]) / 2, trial[:, :2, 2])
        backward = transfer(self.grams.reversed(), self.projector_image, natural)
        count = len(trial)
        with np.errstate(invalid="ignore"):
            both = np.stack([self._cycle(matrix, focal) for matrix in np.split(backward.matrix, 2)])
            sums = both.sum(axis=1)
        better = np.argmin(np.where(np.isfinite(sums), sums, np.inf), axis=0)
        cycle: Floats = both[better, :, np.arange(count)].T
        cycle[:, ~finite] = np.nan
        return np.concatenate([[np.abs(pro[:, 0, 1])], [np.abs(pro[:, 0, 0] - pro[:, 1, 1])], cycle])

    def _cycle(self, back: Floats, focal: Floats) -> Floats:
        return np.stack(
            [
                np.abs(back[:, 0, 0] - back[:, 1, 1]),
                np.abs(back[:, 0, 1]),
                np.abs(back[:, 0, 0] - focal),
                np.abs(back[:, 1, 1] - focal),
                np.linalg.norm(back[:, :2, 2] - np.array(self.principal_point_px), axis=1),
            ]
        )


@dataclass(frozen=True)
class PaperSolution:
    """`focal_px` (n,), `objective` (n,): the searched curve; the transfer at its minimum is `best` (one result)."""

    focal_px: Floats
    objective: Floats
    best_focal_px: float
    best: Transfer


def objective_for(matches: Matches, principal_point_px: tuple[float, float]) -> Objective:
    """Prepare the search from matches with face labels. Raises TooFewMatchesError if a face has fewer than four."""
    grams, sample = face_grams(matches), []
    for label in FACES:
        members = np.flatnonzero(matches.labels == label)
        chosen = members[np.linspace(0, len(members) - 1, min(_SAMPLE_PER_FACE, len(members))).astype(np.intp)]
        sample.append(homogeneous(matches.camera_px[chosen].astype(np.float64)))
    return Objective(
        grams, image_of_corner(grams), image_of_corner(grams.reversed()), principal_point_px, tuple(sample)
    )


def exact_search(objective: Objective, focal_px: Floats) -> Floats:
    """E (n,) over a sampled range of focals (n,), the better corner of the two at each."""
    values: Floats = np.min(objective.evaluate(focal_px)[0], axis=0)
    return values


def bounded_search(objective: Objective, focal_px: Floats, values: Floats) -> float:
    """The best focal: Brent's bounded minimiser in the brackets around the lowest minima of a sampled curve."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    low = np.flatnonzero(np.isfinite(values) & (values <= padded[:-2]) & (values <= padded[2:]))
    promising = low[values[low] <= _PROMISING * values[low].min()]
    minima = [int(i) for i in promising[np.argsort(values[promising])][:_BRACKETS]]
    candidates = [(float(values[i]), float(focal_px[i])) for i in minima]
    for i in minima:
        bounds = (float(focal_px[max(i - 1, 0)]), float(focal_px[min(i + 1, len(focal_px) - 1)]))
        result = scipy.optimize.minimize_scalar(
            # Brent's parabola needs finite values: a large number stands for "no corner here".
            lambda focal: min(float(exact_search(objective, np.array([focal]))[0]), 1e9),
            bounds=bounds,
            method="bounded",
            options={"xatol": 1e-2},
        )
        candidates.append((float(result.fun), float(result.x)))
    return min(candidates)[1]


def search(objective: Objective, focal_px: Floats) -> PaperSolution | None:
    """Exact search over `focal_px` (n,), then the bounded optimiser; None where no focal gives a real corner."""
    values = exact_search(objective, focal_px)
    if not np.isfinite(values).any():
        return None
    focal = bounded_search(objective, focal_px, values)
    totals, transfers = objective.evaluate(np.array([focal]))
    which = int(np.argmin(totals[:, 0]))
    best = transfers[which : which + 1]
    return PaperSolution(focal_px, values, focal, best)
