"""The likelihood of all views of a board for a state, with derivatives; and priors on lenses and boards.

Corners deviate in camera pixels, cells of matches in projector pixels, both under Huber's loss.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.boards.parameters import (
    ASPECT,
    BEND,
    CAMERA,
    CENTRE,
    FOCAL,
    LENS,
    PER_DEVICE,
    PER_VIEW,
    PROJECTOR,
    SHARED,
    State,
    flex_columns,
    predict_corners,
    predict_matches,
)
from calib.estimation import Cells, ColumnPrior, Fit, Problem, Term
from calib.numerics import NIELSEN, Bools, Floats, Ints
from calib.refinement import ORDINARY_LENSES, LensPrior

_TAILED = np.array(
    [[device.start + term] for device in (CAMERA, PROJECTOR) for term in (ASPECT, *range(LENS.start, LENS.stop))]
)
# Prior sigmas of devices and boards: they determine what a set of views leaves open.
_ASPECT_SIGMA = 0.002
_LOG_FOCAL_SIGMA = 1.0
_BEND_SIGMA = (0.01, 0.01, 0.01, 0.003, 0.003, 0.003, 0.003)


@dataclass(frozen=True)
class BoardView:
    """One pose of the board."""

    name: str
    """Says in messages which it is."""
    points: Floats
    """Its corners, in lengths from its middle, (N, 2)."""
    corners_px: Floats
    """Where the camera saw them, (N, 2)."""
    cells: Cells
    """Of the matches on it."""

    def corner_cells(self, sigma_px: float = 1.0) -> Cells:
        """Its corners as cells with errors of this size, whose pixels are the camera's."""
        ones, label = np.ones(len(self.points)), np.zeros(len(self.points), np.int32)
        return Cells(self.corners_px, self.corners_px, label, sigma_px * ones, ones, sigma_px, 0.0)


@dataclass(frozen=True)
class BoardVariances:
    """Variances of each coordinate: of the corners of each view (V,), of each view's cells, (M,) each."""

    corners: Floats
    cells: tuple[Floats, ...]

    def change(self, before: "BoardVariances") -> float:
        """The largest difference of a variance's logarithm."""
        pairs = zip((self.corners, *self.cells), (before.corners, *before.cells), strict=True)
        return max(float(np.abs(np.log(own / earlier)).max()) for own, earlier in pairs)


@dataclass(frozen=True)
class Prior(ColumnPrior):
    """Prior on the shared columns, (SHARED,). Tailed are lens terms and the pixels' shape.

    `flex`: standard deviation of each term by which a view's bend differs from the usual one; 0 for a rigid board.
    """

    flex: float = 0.0

    def terms(self, state: State) -> Iterator[Term]:
        """The cost of a state: of devices and bend, and of what differs between views."""
        yield Term.of_prior(self, state.additive())
        if self.flex:
            columns = flex_columns(len(state.boards)).ravel()
            deviations = np.concatenate([board.flex for board in state.boards]) / self.flex
            yield Term.gaussian(columns, deviations, np.eye(len(columns)) / self.flex)

    def free(self, views: int) -> Bools:
        """Which columns are estimated, (size,)."""
        free = np.ones(SHARED + PER_VIEW * views, np.bool_)
        free[:SHARED] = self.sigma > 0
        free[flex_columns(views)] = self.flex > 0
        return free


def device_prior(
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    bend_terms: int,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
) -> Prior:
    """Prior for devices of these sizes (width, height) and a board with this number of terms of its bend."""
    mean, sigma = np.zeros(SHARED), np.full(SHARED, np.inf)
    sizes = camera_size, projector_size
    for device, (width, height), lens in zip((CAMERA, PROJECTOR), sizes, lenses, strict=True):
        of_device = np.zeros(PER_DEVICE), np.zeros(PER_DEVICE)
        of_device[0][FOCAL], of_device[1][FOCAL] = np.log(1.2 * width), _LOG_FOCAL_SIGMA
        of_device[1][ASPECT] = _ASPECT_SIGMA
        of_device[0][CENTRE], of_device[1][CENTRE] = ((width - 1) / 2, (height - 1) / 2), height / 2
        of_device[0][LENS], of_device[1][LENS] = lens.mean, lens.sigma
        mean[device], sigma[device] = of_device
    sigma[BEND] = _BEND_SIGMA
    sigma[BEND.start + bend_terms : BEND.stop] = 0.0
    return Prior(mean, sigma, (_TAILED,))


@dataclass(frozen=True, eq=False)
class _ViewPart:
    """Cells of a view, by number."""

    view: int
    cells: Cells

    def columns(self, state: State) -> Ints:
        """The state's columns that it depends on, (40,)."""
        return state.columns(self.view)

    def carried(self, _: State) -> None:
        """Its own columns are those of the state."""


@dataclass(frozen=True, eq=False)
class BoardCorners(_ViewPart):
    """Corners, each a cell whose pixels are the camera's."""

    points: Floats
    """(N, 2): on the board."""

    def predict(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Camera pixels (N, 2), their Jacobian (N, 2, 40), and depths (N, 2), twice that before the camera."""
        pixels, jacobian, depth = predict_corners(state, self.points, self.view)
        return pixels, jacobian, np.stack([depth, depth], axis=1)


@dataclass(frozen=True, eq=False)
class BoardMatches(_ViewPart):
    """Means of matches on the board."""

    def predict(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (N, 2), their Jacobian (N, 2, 40), and depths (N, 2)."""
        return predict_matches(state, self.cells.camera_px, self.view)


BoardProblem = Problem[State, BoardCorners | BoardMatches]
BoardFit = Fit[State]


def board_problem(
    views: Sequence[BoardView],
    prior: Prior,
    levels: BoardVariances,
    *,
    free: Bools | None = None,
    matches: bool = True,
) -> BoardProblem:
    """What tells of a state: each view's corners, then its matches. No more than outliers may be behind a device.

    `free` (size,): by default all columns that the prior does not know. Without `matches`, only the camera is seen.
    """
    parts: list[BoardCorners | BoardMatches] = []
    variances = []
    for i, (view, corners, cells) in enumerate(zip(views, levels.corners, levels.cells, strict=True)):
        parts.append(BoardCorners(i, view.corner_cells(), view.points))
        variances.append(np.full(len(view.points), corners))
        if matches:
            parts.append(BoardMatches(i, view.cells))
            variances.append(cells)
    free = prior.free(len(views)) if free is None else free
    return BoardProblem(parts, variances, prior, free, behind=np.inf, damping=NIELSEN)
