"""Problems of maximum likelihood: unknowns in columns, terms of the cost with derivatives, and the likeliest unknowns.

The unknowns are a layout, such as the devices, places and planes of a room. Matches, what ties devices otherwise, and
priors each add terms to the cost, with derivatives by a few of the layout's columns; their sums are the normal
equations. A cell of matches whose deviation r in projector pixels has the variance v of each coordinate costs
|r|² / v, with Huber's loss beyond three sigmas.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import Field, dataclass
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np

from calib.estimation.match_cells import Cells
from calib.estimation.priors import ColumnPrior
from calib.geometry import PER_PLANE, Plane, tangent_basis
from calib.numerics import (
    Bools,
    Damping,
    Floats,
    Ints,
    Quadratic,
    compiled,
    covariance_of,
    descend,
    huber_loss,
    huber_weights,
)

CONVERGED = 1e-4  # in cost: a hundredth of a sigma
_STEPS = 60
_DAMPING = Damping(first=1e-6, least=1e-13, most=1e4, growth=10.0, relief=0.05, by_gain=True)
PLANE = slice(-PER_PLANE, None)  # within a part's own columns
ROBUST_SIGMAS = 3.0  # of Huber's loss
_LEAST_IN_FRONT = 0.98  # of the cells of a part
_BEHIND = 100.0  # cost of a cell behind a device, as for a deviation of ten sigmas


class Layout(Protocol):
    """What is unknown. Steps are (size,)."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def size(self) -> int:
        """Number of columns."""

    def moved(self, step: Floats) -> Self:
        """After a step."""


class PlaneLayout(Layout, Protocol):
    """Devices, where they stand, and planes: a `Room`, or a network."""

    @property
    def planes(self) -> tuple[Plane, ...]:
        """All planes."""

    def plane_columns(self, plane: int) -> slice:
        """Columns of a plane: two tilts and the offset."""


AnyLayout = TypeVar("AnyLayout", bound=Layout)
AnyPlanes = TypeVar("AnyPlanes", bound=PlaneLayout)
LayoutT = TypeVar("LayoutT", bound=Layout, contravariant=True)


@dataclass(frozen=True, eq=False)
class Term(Quadratic):
    """What is added to the cost; its gradient (Q,) and information (Q, Q) are by a few of a layout's columns."""

    columns: Ints
    """(Q,): those that it depends on."""

    @classmethod
    def gaussian(cls, columns: Ints, deviations: Floats, slopes: Floats) -> "Term":
        """Of deviations (N,) in sigmas, with their derivatives (N, Q)."""
        return cls(float(deviations @ deviations), slopes.T @ deviations, slopes.T @ slopes, columns)

    @classmethod
    def of_prior(cls, prior: ColumnPrior, values: Floats) -> "Term":
        """Of a layout's first columns, with these values, under a prior on each."""
        cost, gradient, curvature = prior.misfit(values)
        return cls(float(cost.sum()), gradient, np.diag(curvature), np.arange(len(values)))

    @classmethod
    def robust(
        cls, columns: Ints, residuals: Floats, jacobian: Floats, limit: Floats | float = ROBUST_SIGMAS
    ) -> "Term":
        """Of residuals (N, D) in sigmas, with their derivatives (N, D, Q), under Huber's loss beyond a `limit`."""
        size = np.linalg.norm(residuals, axis=1)
        root = np.sqrt(huber_weights(size, limit))
        rows = (jacobian * root[:, None, None]).reshape(-1, jacobian.shape[2])
        off = (residuals * root[:, None]).ravel()
        return cls(float(np.sum(huber_loss(size, limit))), rows.T @ off, rows.T @ rows, columns)


def add_up(size: int, terms: Iterable[Term]) -> Quadratic:
    """The sum of terms, with the derivatives by all columns of a layout of this size."""
    cost, gradient, information = 0.0, np.zeros(size), np.zeros((size, size))
    for term in terms:
        cost += term.cost
        _add(term.columns.astype(np.int64, copy=False), term.gradient, term.information, gradient, information)
    return Quadratic(cost, gradient, information)


@compiled
def _add(columns: Ints, slope: Floats, curvature: Floats, gradient: Floats, information: Floats) -> None:
    """Add to the gradient and the information, in a fifth of the time of NumPy's."""
    for i in range(len(columns)):
        gradient[columns[i]] += slope[i]
        for j in range(len(columns)):
            information[columns[i], columns[j]] += curvature[i, j]


class Part(Protocol[LayoutT]):
    """Cells of matches that a layout predicts.

    Derivatives are by P own columns, or by the layout's `columns` (Q,).
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def cells(self) -> Cells:
        """Means of matches, (M,)."""

    def predict(self, layout: LayoutT) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (M, 2) of its cells, their Jacobian (M, 2, P), and depths (M, 2).

        Depths are those before both devices, not positive where the prediction means nothing.
        """

    def columns(self, layout: LayoutT) -> Ints:
        """The layout's columns that it depends on, (Q,)."""

    def carried(self, layout: LayoutT) -> Floats | None:
        """How its own columns follow those, (P, Q); None if they are these."""


class PlanePart(Part[LayoutT], Protocol[LayoutT]):
    """The cells of one `plane`, by number in the layout, that one `capture` shows.

    The last three own columns are tilts and offset of the plane in the camera's frame.
    """

    @property
    def capture(self) -> int:
        """Number of the station, or of the pair of camera and projector."""

    @property
    def plane(self) -> int:
        """Number of the plane."""

    def predict(self, layout: LayoutT, camera_px: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """The prediction of its cells, or of `camera_px` (N, 2)."""

    def carried(self, layout: LayoutT) -> Floats:
        """How its own columns follow those of the layout, (P, Q)."""

    def points(self, layout: LayoutT) -> Floats:
        """Where the rays of its cells meet the plane, (M, 3) in the layout's frame."""


PartT = TypeVar("PartT", bound=Part[Any], covariant=True)
AnyPlanePart = TypeVar("AnyPlanePart", bound=PlanePart[Any])


class Joint(Protocol[LayoutT]):
    """What ties devices or stations other than by cells."""

    def misfit(self, layout: LayoutT) -> Term:
        """What it adds to the cost."""


class Prior(Protocol[LayoutT]):
    """What is known before any match is seen."""

    def terms(self, layout: LayoutT) -> Iterable[Term]:
        """What it adds to the cost."""


@dataclass(frozen=True, eq=False)
class Fit(Quadratic, Generic[AnyLayout]):
    """A state of a layout with its cost."""

    state: AnyLayout
    residuals: tuple[Floats, ...]
    """(M, 2) of each part, in pixels."""


@dataclass(frozen=True, eq=False)
class Problem(Generic[AnyLayout, PartT]):
    """What tells of a layout."""

    parts: Sequence[PartT]
    """Cells of matches."""
    variances: Sequence[Floats]
    """(M,) for each part, of each coordinate of each cell."""
    prior: Prior[AnyLayout]
    """Of the layout."""
    free: Bools
    """(size,): the columns that are estimated."""
    joints: Sequence[Joint[AnyLayout]] = ()
    """What else ties it."""
    behind: float = _BEHIND
    """Cost of each cell of a part that has many behind a device. It has no gradient."""
    damping: Damping = _DAMPING
    """Of the descent."""

    def evaluate(self, layout: AnyLayout) -> Fit[AnyLayout]:
        """The cost of a layout with its derivatives."""
        misfits = [self._misfit(*cells, layout) for cells in zip(self.parts, self.variances, strict=True)]
        joints = (joint.misfit(layout) for joint in self.joints)
        total = add_up(layout.size, (*self.prior.terms(layout), *(term for term, _ in misfits), *joints))
        residuals = tuple(residual for _, residual in misfits)
        return Fit(total.cost, total.gradient, total.information, layout, residuals)

    def minimise(
        self,
        layout: AnyLayout,
        *,
        tolerance: float = CONVERGED,
        steps: int = _STEPS,
        enough: Callable[[float, float], bool] | None = None,
    ) -> Fit[AnyLayout]:
        """The nearest minimum over the free columns, by Levenberg and Marquardt.

        Ends when a further step promises to lower the cost by less than `tolerance`, or when `enough` of the cost and
        of this decrement is true.
        """
        return descend(
            self.evaluate(layout),
            lambda fit, step: self.evaluate(fit.state.moved(step)),
            enough or (lambda _, decrement: decrement < tolerance),
            self.damping,
            steps,
            free=np.flatnonzero(self.free),
        )

    def covariance(self, fit: Quadratic) -> Floats:
        """The covariance (size, size) by a fit's curvature; zero where a column is held."""
        return covariance_of(fit.information, self.free)

    def response(self, fit: Quadratic, pull: Floats) -> Floats:
        """To first order, the changes (size, K) of a fit if half its gradient is less by pulls (size, K)."""
        free = np.flatnonzero(self.free)
        moved = np.zeros_like(pull)
        moved[free] = np.linalg.solve(fit.information[np.ix_(free, free)], pull[free])
        return moved

    def _misfit(self, part: Part[AnyLayout], variance: Floats, layout: AnyLayout) -> tuple[Term, Floats]:
        """What a part adds to the cost, and its residuals (M, 2)."""
        predicted, jacobian, depths = part.predict(layout)
        residual, observed_px = np.empty_like(predicted), np.ascontiguousarray(part.cells.projector_px)
        own = np.arange(jacobian.shape[2], dtype=np.int32)
        slope, curvature = np.zeros(len(own)), np.zeros((len(own), len(own)))
        cost = misfit(predicted, observed_px, jacobian, depths, variance, own, residual, slope, curvature)
        if not np.isfinite(cost):
            cost, slope, curvature = self.behind * len(observed_px), np.zeros_like(slope), np.zeros_like(curvature)
        carried = part.carried(layout)
        if carried is not None:
            slope, curvature = carried.T @ slope, carried.T @ curvature @ carried
        return Term(cost, slope, curvature, part.columns(layout)), residual


@compiled
def misfit(
    predicted: Floats,
    observed: Floats,
    jacobian: Floats,
    depths: Floats,
    variance: Floats,
    columns: Ints,
    residual: Floats,
    gradient: Floats,
    information: Floats,
) -> float:
    """Return cost and residuals of one capture's cells; add to half the gradient and half the Gauss–Newton Hessian.

    A cell behind a device, or on the horizon, has a constant cost.
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
        x, y = predicted[i, 0] - observed[i, 0], predicted[i, 1] - observed[i, 1]
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


def squareness(layout: PlaneLayout, pairs: Sequence[tuple[int, int]], sigma: float) -> Iterator[Term]:
    """Pairs of planes that are perpendicular but for a standard deviation, in radians."""
    for pair in pairs:
        normals = [layout.planes[plane].normal for plane in pair]
        columns = [np.r_[layout.plane_columns(plane)][:2] for plane in pair]
        slopes = [tangent_basis(own).T @ normal for own, normal in zip(normals, normals[::-1], strict=True)]
        off = np.array([normals[0] @ normals[1]]) / sigma
        yield Term.gaussian(np.concatenate(columns), off, np.concatenate(slopes)[None] / sigma)
