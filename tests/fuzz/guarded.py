"""Allowed outcomes of an input: a result, or one of our errors, with a message that fits a screen.

A terminal must show such a message and not interpret it. Any other outcome is a finding.
"""

import re
from collections.abc import Callable

import numpy as np

from calib.refusal import RefusalError
from scanner.errors import InputError
from scanner.ui import failure_of
from tests.fuzz.mutations import Random

Run = Callable[[Random], None]
MOST_CHARACTERS = 20_000
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_MOST_LINES = 100


class RejectedError(Exception):
    """The input was refused with one of our errors."""


def rng_of(seed: int, number: int) -> Random:
    """The random numbers of one input."""
    return np.random.default_rng([seed, number])


def guarded(read: Run) -> Run:
    """The target, with the messages of our own errors checked."""

    def run(rng: Random) -> None:
        try:
            read(rng)
        except (InputError, RefusalError) as error:
            message = failure_of(error).message
            assert not _OBEYED.search(message), f"a terminal obeys {message!r}"
            assert message.count("\n") < _MOST_LINES, "longer than a screen"
            assert len(message) < MOST_CHARACTERS, "longer than a screen"
            raise RejectedError from error

    return run
