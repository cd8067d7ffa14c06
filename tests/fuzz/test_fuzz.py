"""A few inputs for every reader; `make fuzz` runs the same for hours and checks memory and time."""

from pathlib import Path

import pytest

from tests.fuzz.guarded import RejectedError, rng_of
from tests.fuzz.runner import HANG_S, fuzz
from tests.fuzz.targets import PLANTED, TARGETS

_SLOW = {"calibrating": 4, "results": 6, "capture": 20, "board": 2, "batch": 12, "compared": 6, "left_behind": 20}
_ANSWERED = {"log", "left_behind", "asked"}  # whatever they are given
_INPUTS = 60
_SEED = 2026


@pytest.mark.filterwarnings("ignore")  # as in the program, where they go to the log
@pytest.mark.parametrize("target", TARGETS)
def test_every_reader_gives_a_result_or_one_of_our_errors(target: str, tmp_path: Path) -> None:
    run, rejected = TARGETS[target](tmp_path), 0
    inputs = _SLOW.get(target, _INPUTS)
    for number in range(inputs):
        try:
            run(rng_of(_SEED, number))
        except RejectedError:
            rejected += 1
    assert (rejected == 0) == (target in _ANSWERED)


def test_a_process_of_its_own_finds_all_that_a_target_is_made_of() -> None:
    outcome = fuzz("calibration", seed=_SEED, inputs=3, seconds=120)
    assert (outcome.inputs, outcome.findings) == (3, ())


@pytest.mark.parametrize(
    ("planted", "found"),
    [("wrong", "KeyError in targets.py"), ("forever", "hang"), ("memory", "memory"), ("death", "died: exit code 3")],
)
def test_planted_failures_are_found(planted: str, found: str) -> None:
    assert planted in PLANTED
    outcome = fuzz(planted, seed=0, inputs=2, seconds=120, hang_s=0.5 if planted == "forever" else HANG_S)
    assert outcome.inputs == 2
    assert [finding.what.startswith(found) for finding in outcome.findings] == [True]
    assert sum(outcome.kinds.values()) == 2


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("target", "seed", "number"),
    [
        ("compared", 9, 96),  # a lens that brings points to no place at all
        ("results", 77015, 97),  # the same, of the middle of the scene
        ("capture", 77017, 2393),  # a last frame whose name is too long
        ("calibrating", 3, 548),  # no answer beside the best one to compare it with
    ],
)
def test_earlier_findings_are_refused(target: str, seed: int, number: int, tmp_path: Path) -> None:
    with pytest.raises(RejectedError):
        TARGETS[target](tmp_path)(rng_of(seed, number))
