"""A Gaussian prior on a rig from other data, over the parameters that all captures share.

The quadratic approximation around the most likely state replaces those data. It is exact as far as their likelihood is
quadratic within a few sigmas, which holds for boards but not for a single corner.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.geometry import tangent_basis
from calib.numerics import Floats
from calib.refinement.parameters import ROTATION, SHARED, TRANSLATION, State

# Smallest sigma of any parameter: log focal, pixels, lens terms, radians and directions.
_LEAST_OF_DEVICE = (1e-6, 1e-3, 1e-3, 1e-5, 1e-5, 1e-6, 1e-6, 1e-5)
_LEAST = np.array([*_LEAST_OF_DEVICE, *_LEAST_OF_DEVICE, *[1e-7] * 5])


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
        layout = State(
            self.state.camera,
            self.state.projector,
            self.state.rotation,
            self.state.translation,
            state.off_square,
            state.poses,
        )
        return layout.step_to(state)[:SHARED]

    def misfit(self, state: State) -> tuple[float, Floats, Floats]:
        """Return the cost of a state, half its gradient (21,) and half its Hessian (21, 21) in the state's columns."""
        step = self.step_to(state)
        by_columns = np.eye(SHARED)
        # Derivative of log(exp[δ] R) by δ: the inverse of the left Jacobian of SO(3), to second order.
        x, y, z = step[ROTATION]
        turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        by_columns[ROTATION, ROTATION] -= turn / 2 - turn @ turn / 12
        by_columns[TRANSLATION, TRANSLATION] = tangent_basis(self.state.translation).T @ tangent_basis(
            state.translation
        )
        pull = self.precision @ step
        return float(step @ pull), by_columns.T @ pull, by_columns.T @ self.precision @ by_columns
