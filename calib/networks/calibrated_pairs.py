"""What is known of a camera and a projector that are calibrated by themselves, as a factor of a network.

A calibration with its covariance stands for all that it was made from (submaps; Ni, Steedly and Dellaert, "Tectonic
SAM: exact, out-of-core, submap-based SLAM", 2007). What was known of the devices before is part of it, and is taken
out: the network has it once, however many pairs a device belongs to.
"""

from dataclasses import dataclass

import numpy as np

from calib.estimation import Term
from calib.geometry import cross_matrix, tangent_basis
from calib.networks.network import PER_NODE, PLACE, Network
from calib.numerics import Floats, Ints, inverse_of
from calib.refinement import CAMERA, PER_DEVICE, PROJECTOR, ROTATION, SHARED, TRANSLATION, KnownRig, Prior, State

_TURN = slice(PER_DEVICE, PLACE.start)  # of a device's columns


@dataclass(frozen=True, eq=False)
class CalibratedPair:
    """A camera and a projector of a network, by number, that are calibrated by themselves."""

    camera: int
    projector: int
    rig: KnownRig
    """As calibrated."""
    pull: Floats
    """(21,): half the gradient there of what it was calibrated from, without what was known before."""
    precision: Floats
    """(21, 21): the information of what it was calibrated from."""

    @classmethod
    def of(cls, camera: int, projector: int, rig: KnownRig, prior: Prior) -> "CalibratedPair":
        """`prior`: what was known when the rig was calibrated."""
        _, pull, curvature = prior.misfit(rig.state.additive())
        free = np.flatnonzero(np.diag(rig.covariance) > 0)
        among = np.ix_(free, free)
        information = inverse_of(rig.covariance[among])
        scale = np.sqrt(np.diag(information))
        values, axes = np.linalg.eigh((information - np.diag(curvature[free])) / np.outer(scale, scale))
        precision = np.zeros((SHARED, SHARED))
        precision[among] = (axes * np.maximum(values, 0.0)) @ axes.T * np.outer(scale, scale)
        return cls(camera, projector, rig, np.where(np.diag(precision) > 0, -pull, 0.0), precision)

    def columns(self, network: Network) -> Ints:
        """Those of the camera and the projector, (36,)."""
        every = np.arange(network.size, dtype=np.int32)
        return np.concatenate([every[network.device_columns(device)] for device in (self.camera, self.projector)])

    def misfit(self, network: Network) -> Term:
        """The cost of another rig."""
        step, by_rig = self.rig.linearised(self.rig_in(network))
        by_columns = by_rig @ self._by_columns(network)
        pull = self.precision @ step
        cost, gradient = float(step @ (pull + 2 * self.pull)), by_columns.T @ (pull + self.pull)
        return Term(cost, gradient, by_columns.T @ self.precision @ by_columns, self.columns(network))

    def disagreement(self, network: Network, covariance: Floats) -> tuple[float, float]:
        """χ² of how far the pair as calibrated is from what it is in the most likely network, and its expected value.

        `covariance` (size, size): of the network. An estimate from part of what another one is from differs from it by
        the difference of their covariances (Hausman, "Specification tests in econometrics", 1978).
        """
        step, by_rig = self.rig.linearised(self.rig_in(network))
        by_columns, columns = by_rig @ self._by_columns(network), self.columns(network)
        free = np.flatnonzero(np.diag(self.rig.covariance) > 0)
        alone = self.rig.covariance[np.ix_(free, free)]
        together = (by_columns @ covariance[np.ix_(columns, columns)] @ by_columns.T)[np.ix_(free, free)]
        information = inverse_of(alone)
        square = float(step[free] @ information @ step[free])
        return square, float(np.trace(information @ (alone - together)))

    def rig_in(self, network: Network) -> State:
        """What the pair is in a network, in its own baselines."""
        camera, projector = network.devices[self.camera], network.devices[self.projector]
        return State(camera.lens, projector.lens, (projector.pose.inverse() @ camera.pose).in_baselines)

    def _by_columns(self, network: Network) -> Floats:
        """Derivatives (21, 36) of the rig by `columns`."""
        camera, projector = network.devices[self.camera], network.devices[self.projector]
        back, apart = projector.pose.rotation.T, camera.pose.translation - projector.pose.translation
        length = float(np.linalg.norm(apart))
        aside = tangent_basis(back @ apart / length).T @ back / length
        derivatives = np.zeros((SHARED, 2 * PER_NODE))
        of_camera, of_projector = derivatives[:, :PER_NODE], derivatives[:, PER_NODE:]
        of_camera[CAMERA, :PER_DEVICE] = of_projector[PROJECTOR, :PER_DEVICE] = np.eye(PER_DEVICE)
        of_camera[ROTATION, _TURN], of_projector[ROTATION, _TURN] = back, -back
        of_camera[TRANSLATION, PLACE], of_projector[TRANSLATION, PLACE] = aside, -aside
        of_projector[TRANSLATION, _TURN] = aside @ cross_matrix(apart)
        return derivatives
