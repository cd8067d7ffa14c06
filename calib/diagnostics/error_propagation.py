"""First-order propagation of errors (decoder, calibration, scale) to measurements on points.

JCGM 100:2008 (GUM), section 5, in matrix form as in JCGM 102:2011. Errors that all points share are propagated as
signed amounts, which keeps their correlation between two faces, or between both ends of a distance.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calib.diagnostics.spatial_errors import smooth_error_px, smooth_modes
from calib.diagnostics.uncertainty import Uncertainty, moved_calibration
from calib.finding import FindingKind
from calib.geometry import Calibration, Matches, intersect, midpoints
from calib.numerics import Floats, Ints
from calib.pointcloud import FittedPlane, by_projector_px
from calib.refinement import SHARED
from calib.refusal import NoMeasurementError

_STEP_PX = 0.01  # step in projector pixels, for derivatives
_MOST_EVALUATED = 2048  # points where calibration errors are evaluated; sigmas are accurate to 0.2 %
_RULER = 0.03  # half the length of the ruler over its distance

NO_PIXEL = FindingKind(
    "no-pixel",
    "The lens terms of a calibration put the middle of the scene outside of all pixels.",
    "Calibrate the rig again.",
)


@dataclass(frozen=True)
class Budget:
    """The uncertainty budget of one number: standard deviations by source, which `sigma` combines."""

    scatter: float
    """Noise of single matches."""
    smooth: float
    """Errors of the decoder that neighbouring matches share."""
    calibration: float
    """Of its covariance, 0 if unknown."""
    scale: float
    """Of the known length."""
    poses: float = 0.0
    """Of the scans that the points are of, 0 for one scan."""

    @property
    def sigma(self) -> float:
        """The combined standard uncertainty."""
        return float(np.linalg.norm([self.scatter, self.smooth, self.calibration, self.scale, self.poses]))


@dataclass(frozen=True)
class Spread:
    """Errors of several numbers (P,): covariances (P, P) of random and of smooth errors, and the effects `systematic`
    (P, S) of systematic sources of one sigma each.

    The last source is the scale. The last but one is the pixel's footprint, which counts as a smooth error.
    """

    scatter: Floats
    smooth: Floats
    systematic: Floats

    def through(self, jacobian: Floats) -> "Spread":
        """The errors of numbers (Q,) that depend on these by `jacobian` (Q, P)."""
        return Spread(
            jacobian @ self.scatter @ jacobian.T, jacobian @ self.smooth @ jacobian.T, jacobian @ self.systematic
        )

    def part(self, which: slice) -> "Spread":
        """The marginal errors of some of the numbers."""
        return Spread(self.scatter[which, which], self.smooth[which, which], self.systematic[which])

    def budget(self, index: int = 0) -> Budget:
        """The budget of one of the numbers."""
        return _budget(self.scatter[index, index], self.smooth[index, index], self.systematic[index])

    def total(self) -> Budget:
        """The budget of the norm of all numbers, as a vector of expectation zero."""
        amounts = np.sqrt(np.sum(self.systematic**2, axis=0))
        return _budget(np.trace(self.scatter), np.trace(self.smooth), amounts)


def _budget(scatter: float, smooth: float, systematic: Floats) -> Budget:
    *calibration, footprint, scale = systematic
    smooth += footprint**2
    return Budget(_root(scatter), _root(smooth), float(np.linalg.norm(calibration)), float(abs(scale)))


def _root(variance: float) -> float:
    """The square root; infinite for a variance that is not finite, as of too few independent points."""
    return float(np.sqrt(max(variance, 0.0))) if np.isfinite(variance) else np.inf


def stacked(spreads: Sequence[Spread]) -> Spread:
    """The errors of several measurements that share only the systematic sources."""
    return Spread(
        scipy.linalg.block_diag(*(spread.scatter for spread in spreads)),
        scipy.linalg.block_diag(*(spread.smooth for spread in spreads)),
        np.concatenate([spread.systematic for spread in spreads]),
    )


@dataclass(frozen=True)
class SystematicErrors:
    """Errors that all points of a scan share: of the calibration, whose covariance may be unknown, and of the scale.

    `log_scale` (S,): the effect of each source of one sigma on the logarithm of the scale. Sources are states along the
    curved valley of the likelihood, principal directions of the rest of the covariance, the pixel's footprint, and the
    scale itself.
    """

    calibration: Calibration
    uncertainty: Uncertainty | None
    log_scale: Floats

    @property
    def known(self) -> bool:
        """Whether the calibration's covariance is known."""
        return self.uncertainty is not None

    @classmethod
    def of(cls, calibration: Calibration, uncertainty: Uncertainty | None, scale: float = 0.0) -> "SystematicErrors":
        """Made from a calibration. `scale`: relative standard deviation of the baseline, which defines the scale.

        The part that is correlated with the calibration's columns is attributed to those sources.
        """
        if uncertainty is None:
            return cls(calibration, None, np.array([0.0, scale]))
        gain, along = uncertainty.by_log_baseline, uncertainty.along
        across = _directions(uncertainty) @ gain
        with_causes = np.concatenate([np.sqrt(along.probability) * (along.steps @ gain), across])
        rest = np.sqrt(max(scale**2 - float(np.sum(with_causes**2)), 0.0))
        return cls(calibration, uncertainty, np.concatenate([with_causes, [0.0, rest]]))

    def anchored(self, distance: Spread, length: float, scale: float) -> "SystematicErrors":
        """The same errors if the known length is a measured distance instead of the baseline.

        `distance`: errors of that `length` for a known baseline; `scale`: relative sigma of the known length.
        """
        log_scale = -distance.systematic[0] / length
        log_scale[-1] = scale
        return SystematicErrors(self.calibration, self.uncertainty, log_scale)

    def of_points(self, matches: Matches, points: Floats) -> Floats:
        """The effect of each source of one sigma on triangulated points (N, 3): (N, 3, S), in their unit."""
        moved = points[:, :, None] * self.log_scale
        for cause, by_calibration in self._by_calibration(matches, points):
            moved[:, :, cause] += by_calibration.T
        return moved

    def along(self, direction: Floats, matches: Matches, points: Floats) -> Floats:
        """The same along a `direction` (N, 3) for each point: (S, N)."""
        toward = direction.T
        moved: Floats = self.log_scale[:, None] * np.einsum("in,in->n", toward, points.T)
        for cause, by_calibration in self._by_calibration(matches, points):
            moved[cause] += np.einsum("in,in->n", toward, by_calibration)
        return moved

    def _by_calibration(self, matches: Matches, points: Floats) -> Iterator[tuple[int, Floats]]:
        """The number of each source of the calibration, and its effect (3, N) on the points, without the scale."""
        for cause, (calibration, root) in enumerate(self._along):
            yield cause, root * (midpoints(matches, calibration) - points.T)
        for cause, (ahead, behind) in enumerate(self._across, start=len(self._along)):
            yield cause, (midpoints(matches, ahead) - midpoints(matches, behind)) / 2

    def of_function(self, function: Callable[[Calibration], Floats]) -> Floats:
        """The effect of each source of one sigma on numbers (…) computed from a calibration: (…, S)."""
        here = function(self.calibration)
        effects = np.zeros((*here.shape, len(self.log_scale)))
        count = len(self._along)
        for cause, (there, root) in enumerate(self._along):
            effects[..., cause] = root * (function(_grown(there, self.log_scale[cause] / root)) - here)
        for cause, pair in enumerate(self._across, start=count):
            ahead, behind = (
                function(_grown(there, sign * self.log_scale[cause])) for sign, there in zip((1, -1), pair, strict=True)
            )
            effects[..., cause] = (ahead - behind) / 2
        effects[..., -1] = function(_grown(self.calibration, self.log_scale[-1])) - here
        return effects

    @property
    def steps(self) -> Floats:
        """The step (S, 21) of the calibration's columns that each source of one sigma is; 0 for those that are none."""
        if self.uncertainty is None:
            return np.zeros((len(self.log_scale), SHARED))
        along = np.sqrt(self.uncertainty.along.probability)[:, None] * self.uncertainty.along.steps
        return np.concatenate([along, _directions(self.uncertainty), np.zeros((2, SHARED))])

    @cached_property
    def _along(self) -> list[tuple[Calibration, float]]:
        """The calibrations along the valley, and the roots of their probabilities."""
        if self.uncertainty is None:
            return []
        along = self.uncertainty.along
        return [
            (moved_calibration(self.calibration, self.uncertainty, step), float(np.sqrt(probability)))
            for step, probability in zip(along.steps, along.probability, strict=True)
        ]

    @cached_property
    def _across(self) -> list[tuple[Calibration, Calibration]]:
        """Calibrations one sigma to either side, along the principal directions of the rest of the covariance.

        Half the difference of their results is the propagated sigma (GUM, 5.1.3, note 2).
        """
        if self.uncertainty is None:
            return []
        rig, uncertainty = self.calibration, self.uncertainty
        return [
            (moved_calibration(rig, uncertainty, step), moved_calibration(rig, uncertainty, -step))
            for step in _directions(uncertainty)
        ]


def _grown(calibration: Calibration, log_scale: float) -> Calibration:
    return calibration.scaled(np.exp(log_scale))


def _directions(uncertainty: Uncertainty) -> Floats:
    """Steps (21, 21) of one sigma along the principal directions of the covariance without the curved valley."""
    values, vectors = np.linalg.eigh(uncertainty.covariance - uncertainty.along.covariance)
    steps: Floats = (vectors * np.sqrt(values.clip(0))).T
    return steps


def spread_of_points(matches: Matches, errors: SystematicErrors, sigma_px: Floats) -> Spread:
    """Errors of the coordinates of triangulated points, point by point (3 N,); `sigma_px` (N,) of their matches."""
    by_sigma = by_projector_px(matches, errors.calibration, np.full(len(matches), _STEP_PX)) * sigma_px[:, None, None]
    points = intersect(matches, errors.calibration).points
    scatter = scipy.linalg.block_diag(*np.einsum("nia,nja->nij", by_sigma, by_sigma))
    systematic = errors.of_points(matches, points).reshape(3 * len(matches), -1)
    return Spread(scatter, np.zeros_like(scatter), systematic)


@dataclass(frozen=True)
class LinearFit:
    """A linearised fit of a surface with parameters (P,).

    `influence` (P, N): derivatives of the parameters by the distance of each point along its `direction` (N, 3).
    `scatter` (P, P): covariance by the residuals, with errors correlated within each `cluster` (N,).
    """

    influence: Floats
    direction: Floats
    scatter: Floats
    cluster: Ints


def spread_of_fit(fit: LinearFit, matches: Matches, errors: SystematicErrors, offsets: Floats | None = None) -> Spread:
    """Errors of the parameters (P,) of a surface fitted to matches. `offsets` (N,): shifts by the pixel's footprint."""
    influence, direction = fit.influence, fit.direction
    met = intersect(matches, errors.calibration)
    modes = smooth_modes(matches.camera_px)
    smooth_px = smooth_error_px(met.residual_px, modes, fit.cluster)

    chosen, weight = _thinned(influence, fit.cluster)
    some, toward = matches[chosen], direction[chosen]
    along_px = np.einsum("ni,nia->na", toward, by_projector_px(some, errors.calibration, np.full(len(some), _STEP_PX)))
    systematic = weight @ errors.along(toward, some, met.points[chosen]).T
    flat = np.einsum("pn,na,nk->pak", weight, along_px, modes[chosen], optimize=True).reshape(len(influence), -1)
    if offsets is not None:
        systematic[:, -2] += influence @ offsets
    return Spread(fit.scatter, smooth_px**2 * flat @ flat.T, systematic)


def _thinned(influence: Floats, cluster: Ints) -> tuple[Ints, Floats]:
    """Representative points: their indices (C,), and the summed influence (P, C) of the neighbours each represents.

    Systematic effects vary smoothly over a surface, and hardly within a cluster.
    """
    count = influence.shape[1]
    together = -(-count // _MOST_EVALUATED)
    order = np.argsort(cluster, kind="stable")
    ordered = cluster[order]
    begins = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    within = np.arange(count) - np.repeat(begins, np.diff(begins, append=count))
    starts = np.flatnonzero(within % together == 0)
    middles = (starts + np.append(starts[1:], count) - 1) // 2
    return order[middles], np.add.reduceat(influence[:, order], starts, axis=1)


def spread_of_vertex(planes: Sequence[FittedPlane], spreads: Sequence[Spread]) -> tuple[Floats, Spread]:
    """The intersection (3,) of three planes, and its errors."""
    normals = np.stack([plane.normal for plane in planes])
    vertex: Floats = np.linalg.solve(normals, np.array([plane.offset for plane in planes]))
    rises = [np.append(plane.tangents @ (vertex - plane.centre), 1.0) for plane in planes]
    by_parameters = np.asarray(np.linalg.inv(normals) @ scipy.linalg.block_diag(*rises), np.float64)
    return vertex, stacked(spreads).through(by_parameters)


def length_in_the_middle(points: Floats, errors: SystematicErrors) -> Budget:
    """Relative errors of short lengths at the median of points (N, 3), root mean square of the three directions.

    Raises NoMeasurementError if the calibration projects these points to no pixel.
    """
    middle = np.median(points, axis=0)
    half = _RULER * float(np.linalg.norm(middle))
    ends = np.concatenate([middle + half * np.eye(3), middle - half * np.eye(3)])
    rig = errors.calibration
    pixels = rig.camera.project(ends), rig.projector.project(rig.pose @ ends)
    if not np.isfinite(pixels).all():
        raise NoMeasurementError(
            NO_PIXEL, "With these lens terms the middle of the scene has no pixel.", NO_PIXEL.remedy
        )
    moved = errors.of_points(Matches(*pixels), ends)
    strain = np.stack([moved[axis, axis] - moved[3 + axis, axis] for axis in range(3)]) / (2 * half)
    return _budget(0.0, 0.0, np.sqrt(np.mean(strain**2, axis=0)))
