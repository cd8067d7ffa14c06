"""Findings: what is worth knowing about a capture, a calibration or a result, as values that programs can act on.

A finding has a kind, declared once beside the code that finds it. Whoever grades, guides or filters reads the kind and
the data; message and advice are for people. docs/troubleshooting.md lists all kinds, written from these declarations.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

Datum = float | tuple[float, ...]


class Severity(StrEnum):
    """The consequence of a finding for the result."""

    NOTE = "note"
    """The result is as good as it says; this explains it, or tells how to get a better one."""
    WARNING = "warning"
    """Something is not as it should be, and may limit the result."""
    REFUSAL = "refusal"
    """There is no result that the program stands behind."""


@dataclass(frozen=True)
class FindingKind:
    """What may be found. Kinds of one name are equal; the rest is documentation, and checked data."""

    name: str
    """In files, in lower case with hyphens, such as `too-dark`; used once in the program."""
    severity: Severity = field(compare=False)
    meaning: str = field(compare=False)
    """What it means, in a sentence that needs no numbers."""
    remedy: str = field(default="", compare=False)
    """What to do about it, whatever the numbers; '' for nothing."""
    data: tuple[str, ...] = field(default=(), compare=False)
    """Names of the numbers that such a finding may have, which end in their units; shares are from 0 to 1."""


@dataclass(frozen=True)
class Finding:
    """A warning, note or reason for a refusal: a kind, with words and numbers."""

    kind: FindingKind
    message: str
    """What was found, in one or more sentences."""
    advice: str = ""
    """What to do about it, in sentences; '' for nothing."""
    data: Mapping[str, Datum] = field(default_factory=dict)
    """The numbers by name; only names that the kind declares."""

    def __post_init__(self) -> None:
        if undeclared := self.data.keys() - set(self.kind.data):
            raise ValueError(f"{self.kind.name}: declares no {', '.join(sorted(undeclared))} in its data")

    @property
    def severity(self) -> Severity:
        """The consequence of any finding of this kind."""
        return self.kind.severity

    def __str__(self) -> str:
        return f"{self.message} {self.advice}".rstrip()
