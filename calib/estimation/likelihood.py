"""The likelihood of observed planes, with derivatives: of a room's stations, or of a network's pairs.

Cells deviate in projector pixels under Huber's loss, as in `calib.refinement.likelihood`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import Field, dataclass
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np

from calib.geometry import PER_PLANE, Plane, tangent_basis
from calib.numerics import Bools, Damping, Floats, Ints, Quadratic, descend
from calib.refinement import Cells, misfit

CONVERGED = 1e-4  # in cost: a hundredth of a sigma
_STEPS = 60
DAMPING = Damping(first=1e-6, least=1e-13, most=1e4, growth=10.0, relief=0.05, by_gain=True)
PLANE = slice(-PER_PLANE, None)  # within a part's own columns
_BEHIND = 100.0  # cost of a cell of a part behind a device, as for a deviation of ten sigmas


class Layout(Protocol):
    """Devices, where they stand, and planes: a `Room`, or a network. Steps are (size,)."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def size(self) -> int:
        """Number of columns."""

    @property
    def planes(self) -> tuple[Plane, ...]:
        """All planes."""

    def plane_columns(self, plane: int) -> slice:
        """Columns of a plane: two tilts and the offset."""

    def moved(self, step: Floats) -> Self:
        """After a step."""


AnyLayout = TypeVar("AnyLayout", bound=Layout)
LayoutT = TypeVar("LayoutT", bound=Layout, contravariant=True)


class Part(Protocol[LayoutT]):
    """The `cells` of one `plane`, by number in the layout, that one `capture` shows.

    Derivatives are by P own columns, the last three of them tilts and offset of the plane in the camera's frame, or by
    the layout's `columns` (Q,), with `carried` (P, Q) the derivatives of the own ones by them.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def capture(self) -> int:
        """Number of the station, or of the pair of camera and projector."""

    @property
    def plane(self) -> int:
        """Number of the plane."""

    @property
    def cells(self) -> Cells:
        """Means of matches, (M,)."""

    def predict(self, layout: LayoutT, camera_px: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (N, 2) of its cells, or of `camera_px`, their Jacobian (N, 2, P), and depths (N, 2).

        Depths are those before both devices, not positive where the prediction means nothing.
        """

    def points(self, layout: LayoutT) -> Floats:
        """Where the rays of its cells meet the plane, (M, 3) in the layout's frame."""

    def columns(self, layout: LayoutT) -> Ints:
        """The layout's columns that it depends on, (Q,)."""

    def carried(self, layout: LayoutT) -> Floats:
        """How its own columns follow those, (P, Q)."""


AnyPart = TypeVar("AnyPart", bound=Part[Any])


class Joint(Protocol[LayoutT]):
    """What ties devices or stations other than by a plane."""

    def columns(self, layout: LayoutT) -> Ints:
        """The layout's columns that it depends on, (Q,)."""

    def misfit(self, layout: LayoutT) -> tuple[float, Floats, Floats]:
        """Cost, half its gradient (Q,) and half its Gauss–Newton Hessian (Q, Q)."""


class Prior(Protocol[LayoutT]):
    """What is known before any match is seen."""

    def cost(self, layout: LayoutT) -> tuple[float, Floats, Floats]:
        """With half its gradient (size,) and Gauss–Newton Hessian (size, size)."""


@dataclass(frozen=True, eq=False)
class Fit(Quadratic, Generic[AnyLayout]):
    """A layout with its cost, and each part's `residuals` (M, 2) in projector px."""

    layout: AnyLayout
    residuals: tuple[Floats, ...]


def evaluate(
    parts: Sequence[Part[AnyLayout]],
    layout: AnyLayout,
    prior: Prior[AnyLayout],
    variances: Sequence[Floats],
    joints: Sequence[Joint[AnyLayout]] = (),
) -> Fit[AnyLayout]:
    """The cost of a layout with its derivatives.

    `variances`: (M,) for each part, of each coordinate of each cell. A part with many cells behind a device has a
    constant cost, and no gradient.
    """
    cost, gradient, information = prior.cost(layout)
    residuals = []
    for part, variance in zip(parts, variances, strict=True):
        predicted, jacobian, depths = part.predict(layout)
        residual, projector_px = np.empty_like(predicted), np.ascontiguousarray(part.cells.projector_px)
        own_columns = np.arange(jacobian.shape[2], dtype=np.int32)
        slope, curvature = np.zeros(len(own_columns)), np.zeros((len(own_columns), len(own_columns)))
        own = misfit(predicted, projector_px, jacobian, depths, variance, own_columns, residual, slope, curvature)
        residuals.append(residual)
        if not np.isfinite(own):
            cost += _BEHIND * len(projector_px)
            continue
        cost += own
        columns, by_layout = part.columns(layout), part.carried(layout)
        gradient[columns] += by_layout.T @ slope
        information[np.ix_(columns, columns)] += by_layout.T @ curvature @ by_layout
    for joint in joints:
        own, slope, curvature = joint.misfit(layout)
        columns = joint.columns(layout)
        cost += own
        gradient[columns] += slope
        information[np.ix_(columns, columns)] += curvature
    return Fit(cost, gradient, information, layout, tuple(residuals))


def minimise(
    parts: Sequence[Part[AnyLayout]],
    layout: AnyLayout,
    prior: Prior[AnyLayout],
    variances: Sequence[Floats],
    free: Bools,
    *,
    joints: Sequence[Joint[AnyLayout]] = (),
    tolerance: float = CONVERGED,
    damping: Damping = DAMPING,
) -> Fit[AnyLayout]:
    """The nearest minimum over the `free` columns (size,), by Levenberg and Marquardt.

    Ends when a further step promises to lower the cost by less than `tolerance`.
    """

    def moved(fit: Fit[AnyLayout], step: Floats) -> Fit[AnyLayout]:
        return evaluate(parts, fit.layout.moved(step), prior, variances, joints)

    def enough(_: float, decrement: float) -> bool:
        return decrement < tolerance

    start = evaluate(parts, layout, prior, variances, joints)
    return descend(start, moved, enough, damping, _STEPS, free=np.flatnonzero(free))


def squareness(layout: Layout, pairs: Sequence[tuple[int, int]], sigma: float) -> Iterator[tuple[float, Floats]]:
    """How far each of some pairs of planes is from perpendicular, in `sigma` (radians), and its slope (size,)."""
    for pair in pairs:
        normals = [layout.planes[plane].normal for plane in pair]
        slope = np.zeros(layout.size)
        for plane, own, other in zip(pair, normals, normals[::-1], strict=True):
            start = layout.plane_columns(plane).start
            slope[start : start + 2] += tangent_basis(own).T @ other / sigma
        yield float(normals[0] @ normals[1]) / sigma, slope
