"""Priors on parameters: on distortion terms, on columns one by one, and on a rig from other data.

No distortion term is exactly zero. Omitting a term that is just too small to detect makes the sigmas of all other
parameters wrong; with a prior, its uncertainty is kept. docs/method.md gives the origin of the standard deviations. A
column's prior is Gaussian, or heavy-tailed, a mixture of a narrow and a wide Gaussian. Of lenses and walls of which
nothing is said, not even the scale is known: they come from one of several populations, and the data tell which
(`scale_mixture.py`).

What other data say of a rig is the quadratic approximation around the most likely state, which replaces those data. It
is exact as far as their likelihood is quadratic within a few sigmas, which holds for boards but not for a single
corner.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.geometry import cross_matrix, tangent_basis
from calib.numerics import Floats
from calib.refinement.parameters import ROTATION, SHARED, TRANSLATION, State

DECENTERING = 3e-4  # standard deviation of p1 and p2
# The same of populations, and how common they are: published |p| spread over the decades from 0.00002 (machine vision)
# to 0.005 (wide and consumer lenses). docs/method.md names some.
DECENTERINGS = (1e-4, 0.3), (3e-4, 0.4), (1e-3, 0.2), (3e-3, 0.1)
THIRD_RADIAL = 0.01  # of k3
RADIAL = 0.1, 0.03  # of k1, k2
_POWERS = 2, 4, 0, 0, 6  # the image depends on k1 / f², k2 / f⁴, k3 / f⁶; the prior on p1 and p2 is on the numbers
# Smallest sigma of any parameter: log focal, pixels, lens terms, radians and directions.
_LEAST_OF_DEVICE = (1e-6, 1e-3, 1e-3, 1e-5, 1e-5, 1e-6, 1e-6, 1e-5)
_LEAST = np.array([*_LEAST_OF_DEVICE, *_LEAST_OF_DEVICE, *[1e-7] * 5])


@dataclass(frozen=True)
class PrincipalPoint:
    """Prior on a principal point: `px` (x, y) with a standard deviation; 0 means exactly known."""

    px: tuple[float, float]
    sigma_px: float


@dataclass(frozen=True)
class LensPrior:
    """Prior of one device: `mean` and standard deviation `sigma` of k1, k2, p1, p2, k3, all independent.

    A sigma of 0 marks terms that a lens does not have: these stay zero. `point`: a projector's principal point; None
    if no more is known of it than of any device's. A camera's is given separately. `decenterings`: standard deviations
    of p1 and p2 in the populations that the lens may come from, with their shares; none if `sigma` is theirs.
    """

    mean: tuple[float, ...] = (0.0,) * 5
    sigma: tuple[float, ...] = (*RADIAL, DECENTERING, DECENTERING, THIRD_RADIAL)
    point: PrincipalPoint | None = None
    decenterings: tuple[tuple[float, float], ...] = DECENTERINGS

    @property
    def powers(self) -> tuple[int, ...]:
        """Power of the focal length with which each term scales at equal image distortion; 0 for measured lenses."""
        return _POWERS if not any(self.mean) else (0,) * len(_POWERS)

    @property
    def bends(self) -> bool:
        """Whether the lens may have a first radial term."""
        return self.sigma[0] > 0 or self.mean[0] != 0

    @property
    def most_decentred(self) -> "LensPrior":
        """A copy for the widest of its populations, if it has any."""
        if not self.decenterings:
            return self
        widest = max(sigma for sigma, _ in self.decenterings)
        return replace(self, sigma=(*self.sigma[:2], widest, widest, self.sigma[4]))

    def with_sigmas(
        self, decentering: float | None = None, k3: float | None = None, radial: float | None = None
    ) -> "LensPrior":
        """Return a copy with another standard deviation of p1 and p2, of k3, or of k1 and k2, where given."""
        k1, k2, p1, p2, third = self.sigma
        tangential = (p1, p2) if decentering is None else (decentering, decentering)
        populations = self.decenterings if decentering is None else ()
        first, second = (k1, k2) if radial is None else (radial, radial)
        sigma = first, second, *tangential, third if k3 is None else k3
        return replace(self, sigma=sigma, decenterings=populations)


ORDINARY_LENSES = LensPrior(), LensPrior()


@dataclass(frozen=True)
class KnownRig:
    """The most likely `state` (its corners are ignored) and the `covariance` (21, 21) of the shared columns."""

    state: State
    covariance: Floats

    @cached_property
    def safe_covariance(self) -> Floats:
        """The covariance, made invertible where a column was held fixed."""
        return self.covariance + np.diag(_LEAST**2)

    @cached_property
    def precision(self) -> Floats:
        """Inverse of the covariance, (21, 21)."""
        scale = np.sqrt(self.safe_covariance.diagonal())
        inverse: Floats = np.linalg.inv(self.safe_covariance / np.outer(scale, scale)) / np.outer(scale, scale)
        return inverse

    def step_to(self, state: State) -> Floats:
        """Return the step (21,) from the known state to `state`."""
        return replace(self.state.rig, off_square=state.off_square, corners=state.corners).step_to(state)[:SHARED]

    def linearised(self, state: State) -> tuple[Floats, Floats]:
        """The step (21,) from the known state to a state, and its derivatives (21, 21) by the state's columns."""
        step = self.step_to(state)
        by_columns = np.eye(SHARED)
        # Derivative of log(exp[δ] R) by δ: the inverse of the left Jacobian of SO(3), to second order.
        turn = cross_matrix(step[ROTATION])
        by_columns[ROTATION, ROTATION] -= turn / 2 - turn @ turn / 12
        known, own = (tangent_basis(pose.translation) for pose in (self.state.pose, state.pose))
        by_columns[TRANSLATION, TRANSLATION] = known.T @ own
        return step, by_columns

    def misfit(self, state: State) -> tuple[float, Floats, Floats]:
        """Return the cost of a state, half its gradient (21,) and half its Hessian (21, 21) in the state's columns."""
        step, by_columns = self.linearised(state)
        pull = self.precision @ step
        return float(step @ pull), by_columns.T @ pull, by_columns.T @ self.precision @ by_columns
