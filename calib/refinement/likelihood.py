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
from calib.refinement.lens_prior import ORDINARY_LENSES, LensPrior
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, PER_PLANE, PER_POSE, PROJECTOR, SHARED, State, predict
from calib.refinement.tails import with_tails
from calib.refusal import PHOTOS, RIG, Wording

SQUARENESS_DEG = 0.3  # how far walls of ordinary rooms are from square: standard deviation of each angle
ROBUST_SIGMAS = 3.0
_LEAST_IN_FRONT = 0.98
_BEHIND = 100.0  # the cost of a cell behind a device, like one ten sigmas off


@dataclass(frozen=True)
class Prior:
    """Prior on the additive columns of the model: `mean`, `sigma` (size,); 0 = known, infinity = unknown.

    Gaussian but for lens terms and angles, whose prior has tails: few lenses and walls are far off, and those that are
    may be so by many sigmas. `tailed`: the columns of these, (size,). `powers` (size,): with which power of a device's
    focal length a term grows that bends the image alike, where that is what is known of it. `held`: a column that stays
    where it is for now, though it is not known, so that it costs what the prior says. `rig`: what other data say of the
    columns that all captures share, together.
    """

    mean: Floats
    sigma: Floats
    tailed: Bools
    powers: Ints
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

    def misfit(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Of each column (size,): its cost, half the cost's gradient and half its curvature, which is not negative."""
        z = (state.additive() - self.mean) * self.root_precision
        cost, slope, curvature = z**2, z.copy(), np.ones_like(z)
        cost[self.tailed], slope[self.tailed], curvature[self.tailed] = with_tails(z[self.tailed])
        return cost, slope * self.root_precision, curvature * self.root_precision**2

    def radial_scale(self, state: State, other: State) -> Floats:
        """By how much terms that bend the image alike are larger in a state than in another one, (size,)."""
        ratio = np.ones(len(self.powers))
        ratio[CAMERA], ratio[PROJECTOR] = state.camera[0] / other.camera[0], state.projector[0] / other.projector[0]
        scale: Floats = ratio**self.powers
        return scale

    def with_known(self, column: int) -> "Prior":
        """The same with one column held fixed."""
        sigma = self.sigma.copy()
        sigma[column] = 0.0
        return replace(self, sigma=sigma)

    def holding(self, column: int) -> "Prior":
        """The same for a descent that leaves one column alone."""
        return replace(self, held=column)


def of_any_device(size: tuple[int, int], lens: LensPrior) -> tuple[Floats, Floats]:
    """Mean and standard deviation (8,) of a device's columns: what holds for any that is sold, by its image size."""
    width, height = size
    mean = np.array([np.log(1.2 * width), (width - 1) / 2, (height - 1) / 2, *lens.mean])
    return mean, np.array([0.7, height / 2, height / 2, *lens.sigma])


@dataclass(frozen=True)
class Knowledge:
    """What is known before the matches are seen: image sizes (width, height), the camera's principal point with its
    standard deviation (0: exactly known), and how square corners are (standard deviation of the angles; 0: exactly).

    `one_camera`: both images are photos by one unchanged camera, with one radial term. `focal_px`: the camera's focal
    length with its standard deviation, where something is known of it. `rig`: what other data say of it. `lenses`: what
    is known of those of camera and projector.
    """

    camera_size: tuple[int, int]
    projector_size: tuple[int, int]
    principal_point_px: tuple[float, float]
    principal_point_sigma_px: float
    squareness_deg: float
    one_camera: bool = False
    focal_px: tuple[float, float] | None = None
    rig: KnownRig | None = None
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES

    @property
    def words(self) -> Wording:
        """What the devices are called in messages."""
        return PHOTOS if self.one_camera else RIG

    def prior(self, layout: State) -> Prior:
        """As a prior on the columns of states like `layout`.

        Beside what is known of this rig and its lenses, what holds for any device that is sold: a focal of 1.2 image
        widths within a factor of two, and a projector's principal point within half an image height of the centre
        (1 sigma each). What other data say of the rig takes the place of all this.
        """
        mean, sigma = np.zeros(layout.size), np.full(layout.size, np.inf)
        sizes = self.camera_size, self.projector_size
        for device, size, lens in zip((CAMERA, PROJECTOR), sizes, self.lenses, strict=True):
            mean[device], sigma[device] = of_any_device(size, lens)
        if self.rig is not None:
            sigma[:SHARED] = np.inf
        centre = slice(CAMERA.start + 1, CAMERA.start + 3)
        if self.rig is None or self.principal_point_sigma_px == 0:
            mean[centre], sigma[centre] = self.principal_point_px, self.principal_point_sigma_px
        if self.focal_px is not None:
            focal, spread = self.focal_px
            mean[CAMERA.start], sigma[CAMERA.start] = np.log(focal), spread / focal
        if self.one_camera:
            sigma[PROJECTOR] = 0.0  # those columns move with the camera's
        angles = slice(SHARED, layout.pose_columns(0).start)
        sigma[angles] = np.radians(self.squareness_deg)
        powers = np.zeros(layout.size, np.int32)
        if self.rig is None:
            for device, lens in zip((CAMERA, PROJECTOR), self.lenses, strict=True):
                powers[device.start + 3 : device.stop] = lens.powers
        tailed = np.zeros(layout.size, np.bool_)
        for columns in (angles, *(slice(device.start + 3, device.stop) for device in (CAMERA, PROJECTOR))):
            tailed[columns] = True
        for i, pose in enumerate(layout.poses):
            tilts = sigma[layout.pose_columns(i)][PER_POSE:].reshape(-1, PER_PLANE)
            for row, plane in zip(tilts, pose.planes, strict=True):
                row[:2] = plane.tilt_sigma
        return Prior(mean, sigma, tailed, powers, rig=self.rig)


@dataclass(frozen=True)
class Fit(Quadratic):
    """A state with its cost, and the captures' `residuals` (M, 2) in projector px."""

    state: State
    residuals: tuple[Floats, ...]


def evaluate(captures: Sequence[Cells], state: State, prior: Prior, variances: Sequence[Floats]) -> Fit:
    """The cost of a state with its derivatives; infinite where more than stray points fall behind a device.

    `variances`: (M,) for each capture, of each coordinate of each cell.
    """
    of_columns, gradient, curvature = prior.misfit(state)
    cost, information = float(of_columns.sum()), np.diag(curvature)
    if prior.rig is not None:
        told, slope, of_rig = prior.rig.misfit(state)
        cost += told
        gradient[:SHARED] += slope
        information[:SHARED, :SHARED] += of_rig
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
