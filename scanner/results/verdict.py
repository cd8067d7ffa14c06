"""Whether a result can be trusted, in words."""

from dataclasses import dataclass
from typing import Literal

from calib.finding import Finding, FindingKind, without_kinds

# Largest sigma of a focal length: of 130 results, one then errs by over 2 %, which bends a room by about twice the
# deviation of its walls from square.
MEASUREMENT_GRADE = 0.0075

# Number of reasons shown with every verdict: the accuracy of lengths, and the basis of the grade.
DECISIVE = 2

Grade = Literal["good", "fair", "refused"]
SIGNS: dict[str, str] = {"good": "✓", "fair": "◐", "refused": "✕"}


@dataclass(frozen=True)
class Verdict:
    """An answer to whether a result can be trusted."""

    grade: Grade
    headline: str
    """The answer in a sentence."""
    reasons: tuple[str, ...]
    """Why, in sentences, those that decide first."""
    advice: str = ""
    """What to do next; '' for nothing."""
    findings: tuple[Finding, ...] = ()
    """All that was found out about the result."""
    kinds: tuple[FindingKind, ...] = ()
    """Kinds of findings that the reasons say already, where they were found."""

    @property
    def further(self) -> tuple[Finding, ...]:
        """The findings that the reasons do not say."""
        return without_kinds(self.findings, *self.kinds)

    @property
    def sign(self) -> str:
        """The grade in one character."""
        return SIGNS[self.grade]
