"""The problem of captures that show corners: what is known before, and their cells.

The cost is Σ |r_i|² / v_i + Σ ((p − prior) / σ_prior)². r_i is the deviation of a cell of matches in projector pixels,
v_i the variance of each of its coordinates; Huber's loss applies beyond three sigmas (`calib.estimation.problem`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from calib.estimation import Cells, ColumnPrior, Fit, Population, Problem, Term
from calib.geometry import PER_PLANE, PER_POSE
from calib.numerics import Bools, Damping, Floats, Ints
from calib.refinement.parameters import CAMERA, PER_CORNER, PROJECTOR, SHARED, TANGENTIAL, State, predict
from calib.refinement.priors import ORDINARY_LENSES, KnownRig, LensPrior, PrincipalPoint
from calib.refusal import PHOTOS, RIG, Wording

_DAMPING = Damping(first=1e-7, least=1e-13, most=1e4, growth=30.0, relief=1 / 30)
SQUARENESS_DEG = 0.3  # standard deviation of the angles between walls of ordinary rooms around 90°
# The same of populations, and how common they are. DIN 18202, table 2, allows edges of 0.5 to 1 m 6 mm, of 1 to 3 m
# 8 mm, of 3 to 6 m 12 mm: 0.1 to 0.3°. Rooms of old houses are about 1° off.
SQUARENESSES_DEG = tuple((sigma_deg, 1 / 3) for sigma_deg in (0.1, 0.3, 0.9))


@dataclass(frozen=True)
class Prior(ColumnPrior):
    """Prior on the additive columns of the model, (size,). Tailed are lens terms, one by one, and angles, the three of
    a corner in one row.

    `powers` (size,): power of a device's focal length with which a term scales for the same image distortion, if the
    prior is on the distortion of the image. `populations`: of columns whose `sigma` is not known. `held`: an unknown
    column that is held for now; its prior still counts. `rig`: joint prior from other data on the columns that all
    captures share.
    """

    powers: Ints
    populations: tuple[Population, ...] = ()
    held: int | None = None
    rig: KnownRig | None = None

    @cached_property
    def free(self) -> Bools:
        """Columns that are estimated, (size,)."""
        free = self.sigma > 0
        if self.held is not None:
            free[self.held] = False
        return free

    def radial_scale(self, state: State, reference: State) -> Floats:
        """Return the ratio (size,) of terms that distort the image equally in `state` and in `reference`."""
        ratio = np.ones(len(self.powers))
        ratio[CAMERA], ratio[PROJECTOR] = (
            state.camera[0] / reference.camera[0],
            state.projector[0] / reference.projector[0],
        )
        return ratio**self.powers

    def for_focals_of(self, state: State, reference: State) -> "Prior":
        """Return the prior of lenses that distort the image in `state` as much as these do in `reference`."""
        return replace(self, sigma=self.sigma * self.radial_scale(state, reference))

    def with_sigmas(self, columns: Ints, sigma: float | Floats) -> "Prior":
        """Return a copy with other standard deviations of some columns."""
        changed = self.sigma.copy()
        changed[columns] = sigma
        return replace(self, sigma=changed)

    def terms(self, state: State) -> Iterator[Term]:
        """What it adds to the cost of a state."""
        yield Term.of_prior(self, state.additive())
        if self.rig is not None:
            yield Term(*self.rig.misfit(state), np.arange(SHARED))

    def holding(self, column: int) -> "Prior":
        """Return a copy for a minimisation that leaves one column unchanged."""
        return replace(self, held=column)


def of_any_device(size: tuple[int, int], lens: LensPrior) -> tuple[Floats, Floats]:
    """Mean and standard deviation (8,) of a device's columns: what holds for any that is sold, by its image size."""
    width, height = size
    point = lens.point or PrincipalPoint(((width - 1) / 2, (height - 1) / 2), height / 2)
    mean = np.array([np.log(1.2 * width), *point.px, *lens.mean])
    return mean, np.array([0.7, point.sigma_px, point.sigma_px, *lens.sigma])


@dataclass(frozen=True)
class Knowledge:
    """Prior knowledge: image sizes (width, height), the camera's principal point with its standard deviation
    (0: exactly known), and the standard deviation of the corners' angles around 90° (0: exactly square).

    `one_camera`: both images are photos by one unchanged camera, with one radial term. `focal_px`: prior on the
    camera's focal length as mean and standard deviation, if any. `rig`: prior on the rig from other data. `lenses`:
    priors on the lenses of camera and projector, and on the projector's principal point. `squarenesses_deg`: standard
    deviations of the angles in the populations that the corners may come from, and their shares; none if it is known.
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
    squarenesses_deg: tuple[tuple[float, float], ...] = ()

    def with_squareness(self, squareness_deg: float | None) -> "Knowledge":
        """Return a copy with a standard deviation of the corners' angles; None: nothing is said of them."""
        if squareness_deg is None:
            return replace(self, squareness_deg=SQUARENESS_DEG, squarenesses_deg=SQUARENESSES_DEG)
        return replace(self, squareness_deg=squareness_deg, squarenesses_deg=())

    @property
    def of_decentred_lenses(self) -> "Knowledge":
        """The same of lenses from the most decentred populations, as far as their populations are not known."""
        camera, projector = self.lenses
        return replace(self, lenses=(camera.most_decentred, projector.most_decentred))

    @property
    def words(self) -> Wording:
        """What the devices are called in messages."""
        return PHOTOS if self.one_camera else RIG

    @property
    def projector_centre_px(self) -> tuple[float, float]:
        """Where the projector's principal point is expected: in the middle of its image, if nothing is known."""
        width, height = self.projector_size
        point = self.lenses[1].point
        return ((width - 1) / 2, (height - 1) / 2) if point is None else point.px

    def holding(self, state: State) -> State:
        """Return the state with what is exactly known of its devices."""
        if state.one_camera:
            return state
        prior = self.prior(state)
        known, mean = prior.sigma == 0, prior.mean
        return replace(
            state,
            camera=np.where(known[CAMERA], mean[CAMERA], state.camera),
            projector=np.where(known[PROJECTOR], mean[PROJECTOR], state.projector),
        )

    def prior(self, layout: State) -> Prior:
        """Return the prior on the columns of states like `layout`.

        In addition to the knowledge of this rig and its lenses, it contains what holds for any commercial device: a
        focal of 1.2 image widths within a factor of two, and a projector's principal point within half an image height
        of the centre (1 sigma each). A prior from other data (`rig`) replaces all this.
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
        point = self.lenses[1].point
        if self.rig is not None and point is not None and point.sigma_px == 0:
            centre = slice(PROJECTOR.start + 1, PROJECTOR.start + 3)
            mean[centre], sigma[centre] = point.px, 0.0
        if self.focal_px is not None:
            focal, spread = self.focal_px
            mean[CAMERA.start], sigma[CAMERA.start] = np.log(focal), spread / focal
        if self.one_camera:
            sigma[PROJECTOR] = 0.0  # those columns move with the camera's
        angles = slice(SHARED, SHARED + PER_CORNER * len(layout.off_square))
        sigma[angles] = np.radians(self.squareness_deg)
        powers = np.zeros(layout.size, np.int32)
        if self.rig is None:
            for device, lens in zip((CAMERA, PROJECTOR), self.lenses, strict=True):
                powers[device.start + 3 : device.stop] = lens.powers
        terms = np.concatenate([np.arange(device.start + 3, device.stop) for device in (CAMERA, PROJECTOR)])
        tailed = terms[:, None], np.arange(angles.start, angles.stop).reshape(-1, PER_CORNER)
        for i, corner in enumerate(layout.corners):
            tilts = sigma[layout.corner_columns(i)][PER_POSE:].reshape(-1, PER_PLANE)
            for row, plane in zip(tilts, corner.planes, strict=True):
                row[:2] = plane.tilt_sigma
        populations = tuple(self._populations(tailed[1].ravel(), sigma))
        return Prior(mean, sigma, tailed, powers, populations, rig=self.rig)

    def _populations(self, angles: Ints, sigma: Floats) -> Iterator[Population]:
        """Those of each lens, unless other data determine it, and of all corners, which are of one house.

        `sigma` (size,): standard deviations of all columns; exactly known ones are of no population.
        """
        for device, lens in zip((CAMERA, PROJECTOR), self.lenses, strict=True):
            columns = device.start + np.array(TANGENTIAL)
            if lens.decenterings and self.rig is None and sigma[columns].all():
                yield Population.of(columns, lens.decenterings)
        if self.squarenesses_deg and len(angles):
            in_radians = [(float(np.radians(sigma)), share) for sigma, share in self.squarenesses_deg]
            yield Population.of(angles, in_radians)


@dataclass(frozen=True, eq=False)
class CornerMatches:
    """Cells of the corner's faces, and of further planes, in one capture."""

    cells: Cells
    """(M,)."""
    capture: int
    """Number of the capture."""

    def predict(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (M, 2) of the cells, their Jacobian (M, 2, Q) by `columns`, and depths (M, 2)."""
        return predict(state, self.cells.camera_px, self.cells.plane, self.capture)

    def columns(self, state: State) -> Ints:
        """The state's columns that it depends on, (Q,)."""
        return state.columns(self.capture)

    def carried(self, state: State) -> None:
        """None: it has no columns of its own."""


CornerFit = Fit[State]


@dataclass(frozen=True, eq=False)
class CornerProblem(Problem[State, CornerMatches]):
    """What captures and a prior tell of a rig and the corners that it sees.

    The cost is infinite if more than a few points of a capture fall behind a device.
    """

    prior: Prior
    """Of rig and corners."""

    @classmethod
    def of(cls, captures: Sequence[Cells], prior: Prior, variances: Sequence[Floats]) -> Self:
        """Of captures' cells with their `variances` (M,), estimating the columns that the prior leaves free."""
        views = tuple(CornerMatches(cells, i) for i, cells in enumerate(captures))
        return cls(views, tuple(variances), prior, prior.free, behind=np.inf, damping=_DAMPING)

    @property
    def captures(self) -> tuple[Cells, ...]:
        """The cells of each capture."""
        return tuple(view.cells for view in self.parts)

    def under(self, prior: Prior) -> Self:
        """The same captures under another prior."""
        return replace(self, prior=prior, free=prior.free)

    def holding(self, column: int) -> Self:
        """The problem with one column held for now; its prior still counts."""
        return self.under(self.prior.holding(column))
