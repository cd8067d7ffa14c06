"""One capture for all tests of the refinement."""

from dataclasses import dataclass

import numpy as np
import pytest

from calib.estimation import Cells
from calib.refinement.likelihood import CornerFit, CornerProblem, Knowledge, Prior
from calib.refinement.parameters import State
from calib.refinement.profile_minimiser import relax
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture
from tests.support.states import each_a_cell, true_state

SIGMA_PX = 0.1
KNOWLEDGE = Knowledge(
    (PAPER_CAMERA.width, PAPER_CAMERA.height),
    (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height),
    PAPER_CAMERA.principal_point_px,
    0.0,
    0.0,
)


@dataclass(frozen=True)
class Case:
    """A capture of a square corner with ideal lenses, whose cells have errors of `SIGMA_PX`; `best` is its fit."""

    cells: Cells
    truth: State
    problem: CornerProblem
    best: CornerFit

    @property
    def prior(self) -> Prior:
        return self.problem.prior


@pytest.fixture(scope="session")
def case() -> Case:
    capture = random_capture(np.random.default_rng(7), count=800, noise_px=SIGMA_PX, distance=(1.5, 2.5))
    cells, truth = each_a_cell(capture, SIGMA_PX), true_state(capture)
    problem = CornerProblem.of([cells], KNOWLEDGE.prior(truth), [np.full(len(cells), SIGMA_PX**2)])
    return Case(cells, truth, problem, relax(problem, truth, tolerance=1e-6))
