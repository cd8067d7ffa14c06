"""What is known of a rig and of a room before any match is seen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import Term, squareness
from calib.geometry import tangent_basis
from calib.numerics import Bools, Floats, inverse_of
from calib.refinement import SHARED, TRANSLATION, Knowledge, KnownRig, PlacedCorner, State
from calib.rooms.room import Room

_EXACTLY_SQUARE = 1e-3  # degrees; sigma of exactly square walls


@dataclass(frozen=True, eq=False)
class RigPrior:
    """Gaussian prior on the rig: its `mean`, the `precision` (21, 21) of the step from there, and which columns (21,)
    are `known`, that is, held where the start has them.
    """

    mean: State
    precision: Floats
    known: Bools

    @classmethod
    def from_knowledge(cls, knowledge: Knowledge, start: State) -> "RigPrior":
        """What is known of any rig of its image sizes, and of this one's principal point: the prior for stations from
        whose own matches the start was calibrated, which must not count twice.
        """
        corner = PlacedCorner(np.eye(3), np.zeros(3))
        prior = knowledge.prior(replace(start.rig, off_square=np.zeros((1, 3)), corners=(corner,)))
        mean = start.moved(_to_mean(start, prior.mean[:SHARED], prior.sigma[:SHARED]))
        precision = np.diag(prior.root_precision[:SHARED] ** 2)
        return cls(mean, precision, prior.sigma[:SHARED] == 0)

    @classmethod
    def from_calibration(cls, calibrated: State, covariance: Floats) -> "RigPrior":
        """A calibration from other matches than the stations', with its `covariance` (21 or more columns, square);
        a column without variance is known.
        """
        of_rig = covariance[:SHARED, :SHARED]
        known = np.diag(of_rig) <= 0
        precision = np.zeros((SHARED, SHARED))
        safe = KnownRig(calibrated, of_rig).safe_covariance
        precision[np.ix_(~known, ~known)] = inverse_of(safe[np.ix_(~known, ~known)])
        return cls(calibrated.rig, precision, known)

    @classmethod
    def exactly(cls, calibrated: State) -> "RigPrior":
        """The rig as it was calibrated, all of it held."""
        return cls(calibrated.rig, np.zeros((SHARED, SHARED)), np.ones(SHARED, np.bool_))

    def holding(self, columns: Sequence[int]) -> "RigPrior":
        """The same with some columns held where the start has them."""
        known, precision = self.known.copy(), self.precision.copy()
        known[list(columns)] = True
        precision[list(columns)] = precision[:, list(columns)] = 0.0
        return replace(self, precision=precision, known=known)

    def misfit(self, rig: State) -> Term:
        """The cost of a rig, with derivatives in the coordinates of a step from it."""
        by_step = np.eye(SHARED)
        mean, own = (tangent_basis(state.pose.translation) for state in (self.mean, rig))
        by_step[TRANSLATION, TRANSLATION] = mean.T @ own
        deviation = self.mean.step_to(rig)
        pull = self.precision @ deviation
        information = by_step.T @ self.precision @ by_step
        return Term(float(deviation @ pull), by_step.T @ pull, information, np.arange(SHARED))


def _to_mean(start: State, mean: Floats, sigma: Floats) -> Floats:
    """The step (21,) to the mean of parameters with a prior; zero for others."""
    has_prior = np.isfinite(sigma) & (sigma > 0)
    return np.where(has_prior, mean - start.rig.additive(), 0.0)


@dataclass(frozen=True, eq=False)
class RoomPrior:
    """Prior knowledge of a room.

    `square`: pairs of perpendicular planes, with a standard deviation of `square_sigma` radians each. `start`: prior
    mean of the poses, with `place_sigma` of a rotation in radians and of a translation in baselines, for directions
    that no plane determines.
    """

    rig: RigPrior
    square: tuple[tuple[int, int], ...]
    square_sigma: float
    start: Room
    place_sigma: tuple[float, float]

    @classmethod
    def of(
        cls,
        rig: RigPrior,
        square: Sequence[tuple[int, int]],
        squareness_deg: float,
        start: Room,
        place_sigma: tuple[float, float],
    ) -> "RoomPrior":
        """With angles in degrees; 0 is as good as exactly square."""
        pairs = tuple(sorted({(min(pair), max(pair)) for pair in square}))
        return cls(rig, pairs, float(np.radians(max(squareness_deg, _EXACTLY_SQUARE))), start, place_sigma)

    def free(self, observed: Bools) -> Bools:
        """Mask of the estimated columns, (size,): without known parameters of the rig, the first pose, and planes not
        `observed`.
        """
        free = np.ones(self.start.size, np.bool_)
        free[:SHARED] = ~self.rig.known
        free[self.start.place_columns(0)] = False
        for plane in np.flatnonzero(~observed):
            free[self.start.plane_columns(int(plane))] = False
        return free

    def terms(self, room: Room) -> Iterator[Term]:
        """The cost of a room: of the rig, of where the stations are, and of angles."""
        yield self.rig.misfit(room.rig)
        sigma = np.repeat(self.place_sigma, 3)
        step = self.start.step_to(room)
        for station in range(1, len(room.places)):
            columns = np.r_[room.place_columns(station)]
            yield Term.gaussian(columns, step[columns] / sigma, np.diag(1 / sigma))
        yield from squareness(room, self.square, self.square_sigma)
