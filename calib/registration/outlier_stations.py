"""Outlier stations of a group: with a changed rig, or of a changed room.

Calibration errors bend all stations of one unchanged rig equally, so that the surfaces of any two fit equally well. A
changed rig measures other shapes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Pose
from calib.numerics import Floats
from calib.registration.agreement import COARSE, compare_one
from calib.registration.alignment import normal_equations
from calib.registration.range_view import Surfaces

_MOST_CONTRADICTION = 0.05
_MOST_TIMES_WORSE = 1.8
_LEAST_PATCHES = 30
# Prior from a relative error of the calibration, with the weight of this many patches.
_OFF, _SUPPOSED_PATCHES = 0.002, 500.0

ANOTHER_ROOM = FindingKind(
    "another-room",
    "A station is left out: it is of another room, or something was moved.",
    "Leave it out, or take it again with everything at its place.",
    ("looked_through_share",),
)
SOMETHING_MOVED = FindingKind(
    "something-moved",
    "A station is left out: its surfaces are bent otherwise than those of all others.",
    "Do not change the rig between stations, let nothing move, and take the station again.",
    ("deviation_ratio",),
)


@dataclass(frozen=True)
class Misfit:
    """`contradiction`: share of what `station` and others could see of each other that was looked through;
    `times_worse`: its surfaces' distances from the others', over what those of the others among each other let expect.
    """

    station: int
    contradiction: float
    times_worse: float

    @property
    def of_another_shape(self) -> bool:
        """Whether it belongs nowhere, for its surfaces are bent otherwise than all others'."""
        return self.times_worse > _MOST_TIMES_WORSE

    @property
    def finding(self) -> Finding | None:
        """Why it is to be left out, as a clause; None if it is not."""
        if self.of_another_shape:
            return Finding(
                SOMETHING_MOVED,
                Severity.WARNING,
                f"its surfaces deviate {self.times_worse:.1f} times as far from the other stations' as those from each "
                "other: the rig was changed, or something was moved",
                data={"deviation_ratio": self.times_worse},
            )
        if self.contradiction > _MOST_CONTRADICTION:
            return Finding(
                ANOTHER_ROOM,
                Severity.WARNING,
                f"where it fits best, {self.contradiction:.0%} of the surfaces in common view are in space that one of "
                "the stations saw as free: it is of another room, or something was moved",
                data={"looked_through_share": self.contradiction},
            )
        return None


def worst_misfit(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> Misfit | None:
    """The station of a group that fits the others worst; None where only two overlap, for none is then to blame."""
    sums: dict[tuple[int, int], Floats] = {}
    for i, j in combinations(places, 2):
        agreement = compare_one(surfaces[i], surfaces[j], places[i].inverse() @ places[j])
        if agreement.agreeing[0] + agreement.contradicting[0] < _LEAST_PATCHES:
            continue
        fit = normal_equations(surfaces[i], places[i], surfaces[j], places[j], COARSE)
        sums[i, j] = np.array([fit.square, fit.weight, agreement.contradicting[0], agreement.agreeing[0]], np.float64)
    misfits = []
    for k in places:
        own = sum((each for pair, each in sums.items() if k in pair), np.zeros(4))
        rest = sum((each for pair, each in sums.items() if k not in pair), np.zeros(4))
        if own[1] > 0 and rest[1] > 0:
            usual = (rest[0] + _SUPPOSED_PATCHES * _OFF**2) / (rest[1] + _SUPPOSED_PATCHES)
            worse = float(np.sqrt(own[0] / own[1] / usual))
            misfits.append(Misfit(k, float(own[2] / (own[2] + own[3])), worse))
    return max(misfits, key=lambda misfit: (misfit.finding is not None, misfit.times_worse), default=None)
