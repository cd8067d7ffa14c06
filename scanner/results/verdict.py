"""Whether a result can be trusted, in words."""

from dataclasses import dataclass
from typing import Literal

# Largest sigma of a focal length: of 130 results, one then errs by over 2 %, which bends a room by about twice the
# deviation of its walls from square.
MEASUREMENT_GRADE = 0.0075

# Number of reasons shown with every verdict: the accuracy of lengths, and the basis of the grade.
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
