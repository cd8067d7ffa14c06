"""Whether a result can be trusted, in words."""

from dataclasses import dataclass
from typing import Literal

# Of a focal length, one standard deviation: then of 130 results one errs by over 2 %, which bends a room by about twice
# as much as its walls are off square.
MEASUREMENT_GRADE = 0.0075

# Reasons that are said wherever a verdict is: how well lengths are known, and what the grade rests on.
DECISIVE = 2

Grade = Literal["good", "fair", "refused"]
SIGNS: dict[str, str] = {"good": "✓", "fair": "◐", "refused": "✕"}


@dataclass(frozen=True)
class Verdict:
    """`headline` answers the question, `reasons` say why, `advice` what to do next ('' for nothing).

    `notes` are what else a person should know.
    """

    grade: Grade
    headline: str
    reasons: tuple[str, ...]
    advice: str = ""
    notes: tuple[str, ...] = ()

    @property
    def sign(self) -> str:
        """The grade in one character."""
        return SIGNS[self.grade]
