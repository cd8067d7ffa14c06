"""Findings: what is worth knowing about a capture, a calibration or a result, as values that programs can act on.

A finding has a kind, declared once beside the code that finds it. Whoever grades, guides or filters reads the kind,
the severity and the data; message and advice are for people. docs/troubleshooting.md lists all kinds, written from
their declarations by docs/make_findings.py.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

Datum = float | tuple[int, ...]


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
    """What may be found. Kinds of one name are equal; the rest is documentation, and the names of numbers."""

    name: str
    """In files, in lower case with hyphens, such as `too-dark`; declared once in the program."""
    meaning: str = field(compare=False)
    """What it means, in a sentence that needs no numbers."""
    remedy: str = field(default="", compare=False)
    """What to do about it, whatever the numbers; '' for nothing."""
    data: tuple[str, ...] = field(default=(), compare=False)
    """Names of the numbers that such a finding may have. They end in units; shares and ratios have none."""


@dataclass(frozen=True)
class Finding:
    """A note, a warning, or the reason for a refusal."""

    kind: FindingKind
    severity: Severity
    message: str
    """What was found, in one or more sentences."""
    advice: str = ""
    """What to do about it, in sentences; '' for nothing."""
    data: Mapping[str, Datum] = field(default_factory=dict)
    """Numbers by name, of those that the kind declares; a tuple has the numbers of frames, captures or bits."""

    def __post_init__(self) -> None:
        if undeclared := self.data.keys() - set(self.kind.data):
            raise ValueError(f"{self.kind.name} declares no {', '.join(sorted(undeclared))} in its data")

    def __str__(self) -> str:
        return f"{self.message} {self.advice}".strip()

    def number(self, name: str) -> float:
        """The number under a name. Raises KeyError without one."""
        datum = self.data[name]
        if isinstance(datum, tuple):
            raise KeyError(f"{self.kind.name} has several numbers under {name}")
        return datum

    def numbers(self, name: str) -> tuple[int, ...]:
        """The numbers of frames, captures or bits under a name; () without any."""
        numbers = self.data.get(name, ())
        return numbers if isinstance(numbers, tuple) else ()


def of_kinds(findings: Iterable[Finding], *kinds: FindingKind) -> tuple[Finding, ...]:
    """The findings of these kinds, in their order."""
    return tuple(finding for finding in findings if finding.kind in kinds)


def without_kinds(findings: Iterable[Finding], *kinds: FindingKind) -> tuple[Finding, ...]:
    """The findings of all other kinds, in their order."""
    return tuple(finding for finding in findings if finding.kind not in kinds)
