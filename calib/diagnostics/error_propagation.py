"""From what errs (decoder, calibration, scale) to what is measured on points: linear propagation, to first order.

JCGM 100:2008 (GUM), section 5, in matrix form as in JCGM 102:2011. Errors that all points share are followed through
each measurement as signed amounts, so that what they do to two faces, or to both ends of a distance, is correlated as
it is.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from calib.diagnostics.smooth_errors import smooth_error_px, smooth_modes
from calib.diagnostics.uncertainty import Uncertainty, moved_calibration
from calib.geometry import Calibration, Matches, intersect, midpoints
from calib.numerics import Floats, Ints
from calib.pointcloud import Plane, by_projector_px
from calib.refusal import NoMeasurementError

_STEP_PX = 0.01  # of a projector pixel, for derivatives
_MOST_FOLLOWED = 2048  # about so many points, through the errors of a calibration: sigmas are right to 0.2 %
_RULER = 0.03  # half its length, as a share of its distance


@dataclass(frozen=True)
class Budget:
    """Standard deviations of one number by what causes them.

    `scatter`: of single matches; `smooth`: errors of the decoder that neighbouring matches share; `calibration`: its
    covariance, 0 if that is not known; `scale`: of the known length. `sigma` is all of them together.
    """

    scatter: float
    smooth: float
    calibration: float
    scale: float

    @property
    def sigma(self) -> float:
        """The combined standard uncertainty."""
        return float(np.sqrt(self.scatter**2 + self.smooth**2 + self.calibration**2 + self.scale**2))


@dataclass(frozen=True)
class Spread:
    """Errors of several numbers (P,): covariances (P, P) of what errs at random or smoothly, and what systematic causes
    of one sigma each do to them, `systematic` (P, S).

    The last cause is the scale. The last but one is what a pixel averages over; it counts as a smooth error.
    """

    scatter: Floats
    smooth: Floats
    systematic: Floats

    def through(self, jacobian: Floats) -> "Spread":
        """Of numbers (Q,) that depend on these by `jacobian` (Q, P)."""
        return Spread(
            jacobian @ self.scatter @ jacobian.T, jacobian @ self.smooth @ jacobian.T, jacobian @ self.systematic
        )

    def part(self, which: slice) -> "Spread":
        """Of some of the numbers, whatever those of the others are."""
        return Spread(self.scatter[which, which], self.smooth[which, which], self.systematic[which])

    def budget(self, index: int = 0) -> Budget:
        """Of one of the numbers."""
        return _budget(self.scatter[index, index], self.smooth[index, index], self.systematic[index])

    def total(self) -> Budget:
        """Of the length of all numbers as a vector whose expectation is zero."""
        amounts = np.sqrt(np.sum(self.systematic**2, axis=0))
        return _budget(np.trace(self.scatter), np.trace(self.smooth), amounts)


def _budget(scatter: float, smooth: float, systematic: Floats) -> Budget:
    *calibration, footprint, scale = systematic
    smooth += footprint**2
    return Budget(_root(scatter), _root(smooth), float(np.linalg.norm(calibration)), float(abs(scale)))


def _root(variance: float) -> float:
    """The covariance of too few points that err independently is infinite, and its products are not numbers."""
    return float(np.sqrt(max(variance, 0.0))) if np.isfinite(variance) else np.inf


def stacked(spreads: Sequence[Spread]) -> Spread:
    """Of the numbers of several measurements that share nothing but the systematic causes."""
    return Spread(
        block_diag(*(spread.scatter for spread in spreads)),
        block_diag(*(spread.smooth for spread in spreads)),
        np.concatenate([spread.systematic for spread in spreads]),
    )


@dataclass(frozen=True)
class SystematicErrors:
    """What all points of a scan share: the calibration, whose covariance may be unknown, and the scale.

    `log_scale` (S,): what each cause of one sigma does to the logarithm of the scale. The causes are states along the
    curved valley of the likelihood, principal directions of the rest of the covariance, what a pixel averages over, and
    the scale itself.
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
        """`scale`: relative standard deviation of the baseline, which the scale is that of.

        What of it goes with the calibration's columns is part of these causes.
        """
        if uncertainty is None:
            return cls(calibration, None, np.array([0.0, scale]))
        gain, along = uncertainty.by_log_baseline, uncertainty.along
        across = _directions(uncertainty) @ gain
        with_causes = np.concatenate([np.sqrt(along.probability) * (along.steps @ gain), across])
        rest = np.sqrt(max(scale**2 - float(np.sum(with_causes**2)), 0.0))
        return cls(calibration, uncertainty, np.concatenate([with_causes, [0.0, rest]]))

    def anchored(self, distance: Spread, length: float, scale: float) -> "SystematicErrors":
        """The same where the known length, `scale` its relative sigma, is not the baseline but a measured distance.

        `distance`: of that `length` with the baseline known.
        """
        log_scale = -distance.systematic[0] / length
        log_scale[-1] = scale
        return SystematicErrors(self.calibration, self.uncertainty, log_scale)

    def of_points(self, matches: Matches, points: Floats) -> Floats:
        """What each cause of one sigma does to triangulated points (N, 3): (N, 3, S), in their unit."""
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
        """What causes, by number, do to points (3, N) by way of the calibration alone."""
        for cause, (calibration, root) in enumerate(self._along):
            yield cause, root * (midpoints(matches, calibration) - points.T)
        for cause, (ahead, behind) in enumerate(self._across, start=len(self._along)):
            yield cause, (midpoints(matches, ahead) - midpoints(matches, behind)) / 2

    def of_function(self, function: Callable[[Calibration], Floats]) -> Floats:
        """What each cause of one sigma does to numbers (…) that follow from a calibration: (…, S)."""
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
        """One sigma to either side along the principal directions of the rest of the covariance.

        Half the difference of what they give is the propagated sigma (GUM, 5.1.3, note 2).
        """
        if self.uncertainty is None:
            return []
        rig, uncertainty = self.calibration, self.uncertainty
        return [
            (moved_calibration(rig, uncertainty, step), moved_calibration(rig, uncertainty, -step))
            for step in _directions(uncertainty)
        ]


def _grown(calibration: Calibration, log_scale: float) -> Calibration:
    return replace(calibration, translation=calibration.translation * np.exp(log_scale))


def _directions(uncertainty: Uncertainty) -> Floats:
    """Steps (21, 21) of one sigma along the principal directions of what of the covariance is no curve."""
    values, vectors = np.linalg.eigh(uncertainty.covariance - uncertainty.along.covariance)
    steps: Floats = (vectors * np.sqrt(values.clip(0))).T
    return steps


def spread_of_points(matches: Matches, errors: SystematicErrors, sigma_px: Floats) -> Spread:
    """Of the coordinates of triangulated points, point by point (3 N,), matches of `sigma_px` (N,) each."""
    by_sigma = by_projector_px(matches, errors.calibration, np.full(len(matches), _STEP_PX)) * sigma_px[:, None, None]
    points = intersect(matches, errors.calibration).points
    scatter = block_diag(*np.einsum("nia,nja->nij", by_sigma, by_sigma))
    systematic = errors.of_points(matches, points).reshape(3 * len(matches), -1)
    return Spread(scatter, np.zeros_like(scatter), systematic)


@dataclass(frozen=True)
class LinearFit:
    """Parameters (P,) of a surface and how they follow the points: `influence` (P, N) by the distance of each along its
    `direction` (N, 3). `scatter` (P, P): their covariance as far as the residuals tell it, errors being alike within a
    `cluster` (N,).
    """

    influence: Floats
    direction: Floats
    scatter: Floats
    cluster: Ints


def spread_of_fit(fit: LinearFit, matches: Matches, errors: SystematicErrors, offsets: Floats | None = None) -> Spread:
    """Of the parameters (P,) of a surface fitted to matches, which a pixel's footprint sets off by `offsets` (N,)."""
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
    """Some points, which stand for their neighbours in a cluster: their numbers (C,), and the sum of the influence of
    those that each stands for (P, C).

    What systematic causes do varies smoothly over a surface, and hardly within a cluster.
    """
    count = influence.shape[1]
    together = -(-count // _MOST_FOLLOWED)
    order = np.argsort(cluster, kind="stable")
    ordered = cluster[order]
    begins = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    within = np.arange(count) - np.repeat(begins, np.diff(begins, append=count))
    starts = np.flatnonzero(within % together == 0)
    middles = (starts + np.append(starts[1:], count) - 1) // 2
    return order[middles], np.add.reduceat(influence[:, order], starts, axis=1)


def spread_of_vertex(planes: Sequence[Plane], spreads: Sequence[Spread]) -> tuple[Floats, Spread]:
    """The point (3,) in which three planes meet, and its errors."""
    normals = np.stack([plane.normal for plane in planes])
    vertex: Floats = np.linalg.solve(normals, np.array([plane.offset for plane in planes]))
    rises = [np.append(plane.tangents @ (vertex - plane.centre), 1.0) for plane in planes]
    by_parameters = np.asarray(np.linalg.inv(normals) @ block_diag(*rises), np.float64)
    return vertex, stacked(spreads).through(by_parameters)


def length_in_the_middle(points: Floats, errors: SystematicErrors) -> Budget:
    """Relative errors of lengths around the median of points (N, 3), root mean square of the three directions.

    Of a short ruler, whose ends are seen where the calibration has them. Raises NoMeasurementError if that is nowhere.
    """
    middle = np.median(points, axis=0)
    half = _RULER * float(np.linalg.norm(middle))
    ends = np.concatenate([middle + half * np.eye(3), middle - half * np.eye(3)])
    rig = errors.calibration
    seen = rig.camera.project(ends), rig.projector.project(ends @ rig.rotation.T + rig.translation)
    if not np.isfinite(seen).all():
        raise NoMeasurementError(
            "With these lens terms the middle of the scene has no pixel.", "Calibrate the rig again."
        )
    moved = errors.of_points(Matches(*seen), ends)
    strain = np.stack([moved[axis, axis] - moved[3 + axis, axis] for axis in range(3)]) / (2 * half)
    return _budget(0.0, 0.0, np.sqrt(np.mean(strain**2, axis=0)))
