"""One synthetic room for all tests of the estimate."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from calib.estimation import Cells
from calib.refinement import Knowledge
from calib.rooms import RigPrior, Room, RoomEstimate, estimate_room
from calib.synthetic import SyntheticRoom, random_room
from tests.support.known_rigs import cells_of, disturbed, knowledge_of, true_room

STATIONS = 6


@dataclass(frozen=True, eq=False)
class Case:
    """A room, its cells, a disturbed start, and the estimate from there."""

    made: SyntheticRoom
    truth: Room
    start: Room
    cells: list[Cells]
    plane_of: list[tuple[int, ...]]
    found: RoomEstimate

    @property
    def knowledge(self) -> Knowledge:
        return knowledge_of(self.made)

    def estimate(self, plane_of: list[tuple[int, ...]] | None = None, **more: Any) -> RoomEstimate:
        return estimate_room(
            self.cells,
            plane_of or self.plane_of,
            self.start.places,
            self.start.planes,
            self.start.rig,
            RigPrior.from_knowledge(self.knowledge, self.start.rig),
            **more,
        )


def case_of(seed: int, **changes: Any) -> Case:
    rng = np.random.default_rng(seed)
    made = random_room(rng, **{"stations": STATIONS, "count": 4000, **changes})
    truth, numbers = true_room(made)
    cells, plane_of = cells_of(made, numbers)
    start = disturbed(rng, truth, made)
    prior = RigPrior.from_knowledge(knowledge_of(made), start.rig)
    found = estimate_room(cells, plane_of, start.places, start.planes, start.rig, prior)
    return Case(made, truth, start, cells, plane_of, found)


@pytest.fixture(scope="session")
def case() -> Case:
    return case_of(2)
