"""The likelihood of all captures for a state, with derivatives; and the prior: what is known before any match is seen.

The cost is Σ |r_i|² / v_i + Σ ((p − prior) / σ_prior)², r_i being the deviation of a cell of matches in projector
pixels and v_i the variance of each of its coordinates; Huber's loss beyond three sigmas.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Ints, Quadratic, compiled
from calib.refinement.known_rig import KnownRig
from calib.refinement.lens_terms import FURTHER_TERMS
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, PER_PLANE, PER_POSE, PROJECTOR, SHARED, State, predict, without_lens
from calib.refusal import PHOTOS, RIG, Wording

SQUARENESS_DEG = 0.3  # how far walls of ordinary rooms are from square: standard deviation of each angle
ROBUST_SIGMAS = 3.0
# One sigma of what ordinary lenses have of k1, k2, p1, p2, k3.
_LENS_SIGMA = (0.1, 0.03, 1e-3, 1e-3, 0.01)
_LEAST_IN_FRONT = 0.98
_BEHIND = 100.0  # the cost of a cell behind a device, like one ten sigmas off


@dataclass(frozen=True)
class Prior:
    """Gaussian prior on the additive columns of the model: `mean`, `sigma` (size,); 0 = known, infinity = unknown.

    `held`: a column that stays where it is for now, though it is not known, so that it costs what the prior says.
    `rig`: what other data say of the columns that all captures share, together.
    """

    mean: Floats
    sigma: Floats
    held: int | None = None
    rig: KnownRig | None = None

    @cached_property
    def free(self) -> Bools:
        """Columns that are estimated, (size,)."""
        free = self.sigma > 0
        if self.held is not None:
            free[self.held] = False
        return free

    @cached_property
    def free_columns(self) -> Ints:
        """Indices of the columns that are estimated."""
        return np.flatnonzero(self.free)

    @cached_property
    def root_precision(self) -> Floats:
        """1 / σ of the columns that are not known, 0 elsewhere, (size,)."""
        unknown = self.sigma > 0
        return np.where(unknown, 1.0 / np.where(unknown, self.sigma, 1.0), 0.0)

    def deviation(self, state: State) -> Floats:
        """(value − mean) / σ of each column, (size,); zero where the prior says nothing."""
        deviation: Floats = (state.additive() - self.mean) * self.root_precision
        return deviation

    def with_known(self, column: int) -> "Prior":
        """The same with one column held fixed."""
        sigma = self.sigma.copy()
        sigma[column] = 0.0
        return replace(self, sigma=sigma)

    def holding(self, column: int) -> "Prior":
        """The same for a descent that leaves one column alone."""
        return replace(self, held=column)


@dataclass(frozen=True)
class Knowledge:
    """What is known before the matches are seen: image sizes (width, height), the camera's principal point with its
    standard deviation (0: exactly known), and how square corners are (standard deviation of the angles; 0: exactly).

    `one_camera`: both images are photos by one unchanged camera, with one radial term. `focal_px`: the camera's focal
    length with its standard deviation, where something is known of it. `rig`: what other data say of it. `terms`: the
    columns of `FURTHER_TERMS` that the lenses may have; they have none of the others.
    """

    camera_size: tuple[int, int]
    projector_size: tuple[int, int]
    principal_point_px: tuple[float, float]
    principal_point_sigma_px: float
    squareness_deg: float
    one_camera: bool = False
    focal_px: tuple[float, float] | None = None
    rig: KnownRig | None = None
    terms: tuple[int, ...] = ()

    def with_all_terms(self, views: int) -> "Knowledge":
        """The same for lenses that may have every term that so many views of corners, or of a room, can tell of.

        Two photos hardly tell even k2; of boards' rigs the boards have told. To one view of a corner, tangential terms
        do what angles do that are not known.
        """
        tell = views > 1 or self.squareness_deg == 0
        return replace(self, terms=FURTHER_TERMS) if tell and not self.one_camera and self.rig is None else self

    @property
    def words(self) -> Wording:
        """What the devices are called in messages."""
        return PHOTOS if self.one_camera else RIG

    def prior(self, layout: State) -> Prior:
        """As a prior on the columns of states like `layout`.

        Beside what is known of this rig, what holds for any lens that is sold: a projector's focal of one image width
        within a factor of two and its principal point within half an image height of the centre, k1 within 0.1, k2
        within 0.03, p1 and p2 within 0.001 and k3 within 0.01 of zero (1 sigma each). A capture that determines the
        focals to a few per cent does not feel it. The camera's focal has no prior but the range that is swept, unless
        something is known of it. What other data say of the rig takes the place of all this.
        """
        mean, sigma = np.zeros(layout.size), np.full(layout.size, np.inf)
        for device, (width, height) in ((CAMERA, self.camera_size), (PROJECTOR, self.projector_size)):
            mean[device] = without_lens(np.log(1.2 * width), np.array([width - 1, height - 1]) / 2)
            sigma[device] = [0.7, height / 2, height / 2, *_LENS_SIGMA]
        sigma[[column for column in FURTHER_TERMS if column not in self.terms]] = 0.0
        centre = slice(CAMERA.start + 1, CAMERA.start + 3)
        mean[centre], sigma[centre] = self.principal_point_px, self.principal_point_sigma_px
        sigma[CAMERA.start] = np.inf
        if self.focal_px is not None:
            focal, spread = self.focal_px
            mean[CAMERA.start], sigma[CAMERA.start] = np.log(focal), spread / focal
        if self.one_camera:
            sigma[CAMERA.start + 4] = 0.0  # two photos hardly tell k2 from k1
            sigma[PROJECTOR] = 0.0  # those columns move with the camera's
        if self.rig is not None:
            sigma[:SHARED][sigma[:SHARED] > 0] = np.inf
        sigma[SHARED : layout.pose_columns(0).start] = np.radians(self.squareness_deg)
        for i, pose in enumerate(layout.poses):
            tilts = sigma[layout.pose_columns(i)][PER_POSE:].reshape(-1, PER_PLANE)
            for row, plane in zip(tilts, pose.planes, strict=True):
                row[:2] = plane.tilt_sigma
        return Prior(mean, sigma, rig=self.rig)


@dataclass(frozen=True)
class Fit(Quadratic):
    """A state with its cost, and the captures' `residuals` (M, 2) in projector px."""

    state: State
    residuals: tuple[Floats, ...]


def evaluate(captures: Sequence[Cells], state: State, prior: Prior, variances: Sequence[Floats]) -> Fit:
    """The cost of a state with its derivatives; infinite where more than stray points fall behind a device.

    `variances`: (M,) for each capture, of each coordinate of each cell.
    """
    deviation = prior.deviation(state)
    cost = float(deviation @ deviation)
    gradient, information = deviation * prior.root_precision, np.diag(prior.root_precision**2)
    if prior.rig is not None:
        told, slope, curvature = prior.rig.misfit(state)
        cost += told
        gradient[:SHARED] += slope
        information[:SHARED, :SHARED] += curvature
    residuals = []
    for i, (cells, variance) in enumerate(zip(captures, variances, strict=True)):
        predicted, jacobian, depths = predict(state, cells.camera_px, cells.plane, i)
        residual = np.empty(predicted.shape)
        cost += misfit(
            predicted,
            np.ascontiguousarray(cells.projector_px),
            jacobian,
            depths,
            variance,
            state.columns(i),
            residual,
            gradient,
            information,
        )
        residuals.append(residual)
    return Fit(cost, gradient, information, state, tuple(residuals))


@compiled
def misfit(
    predicted: Floats,
    seen: Floats,
    jacobian: Floats,
    depths: Floats,
    variance: Floats,
    columns: Ints,
    residual: Floats,
    gradient: Floats,
    information: Floats,
) -> float:
    """Cost of one capture's cells, and their residuals; adds to half the cost's gradient and Gauss–Newton Hessian.

    A cell behind a device, or on the horizon, costs the same wherever it is.
    """
    cost, behind, count = 0.0, 0, len(columns)
    slope, curvature = np.zeros(count), np.zeros((count, count))
    for i in range(len(predicted)):
        total = 0.0
        for a in range(count):
            total += jacobian[i, 0, a] + jacobian[i, 1, a]
        if not (depths[i, 0] > 0 and depths[i, 1] > 0 and np.isfinite(total)):
            residual[i, 0], residual[i, 1] = 0.0, 0.0
            cost += _BEHIND
            behind += 1
            continue
        x, y = predicted[i, 0] - seen[i, 0], predicted[i, 1] - seen[i, 1]
        residual[i, 0], residual[i, 1] = x, y
        # Huber's loss: the square up to the threshold, linear beyond it.
        size = np.sqrt((x * x + y * y) / variance[i])
        robust = min(1.0, ROBUST_SIGMAS / size)
        cost += robust * size * (2 * size - robust * size)
        weight = robust / variance[i]
        for a in range(count):
            by_x, by_y = weight * jacobian[i, 0, a], weight * jacobian[i, 1, a]
            slope[a] += by_x * x + by_y * y
            for b in range(a + 1):
                curvature[a, b] += by_x * jacobian[i, 0, b] + by_y * jacobian[i, 1, b]
    for a in range(count):
        gradient[columns[a]] += slope[a]
        for b in range(count):
            information[columns[a], columns[b]] += curvature[max(a, b), min(a, b)]
    return cost if behind <= (1 - _LEAST_IN_FRONT) * len(predicted) else np.inf
