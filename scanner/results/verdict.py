"""Whether a result can be trusted, in words, and as keys of calibration.yaml or of what stands in its place."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from calib.finding import Datum, Finding, FindingKind, Severity, without_kinds
from scanner.io import Entry, Number, block_yaml, read_yaml, validate
from scanner.results.names import CALIBRATION_FILE, NETWORK_FILE, REFUSAL_FILE

# Largest sigma of a focal length: of 130 results, one then errs by over 2 %, which bends a room by about twice the
# deviation of its walls from square.
MEASUREMENT_GRADE = 0.0075

# Number of reasons shown with every verdict: the accuracy of lengths, and the basis of the grade.
DECISIVE = 2

Grade = Literal["good", "fair", "refused"]
SIGNS: dict[str, str] = {"good": "✓", "fair": "◐", "refused": "✕"}


def fit_together(count: int, total: int, whole: str) -> str:
    """'All 6 stations fit together as one room', or '5 of 6 stations …', without a full stop."""
    return f"{'All ' if count == total else f'{count} of '}{total} stations fit together as one {whole}"


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


_SIGNIFICANT_DIGITS = 6


class _VerdictEntry(Entry):
    grade: Grade
    headline: str
    reasons: list[str]
    advice: str
    kinds: list[str] = Field(default_factory=list)


class _FindingEntry(Entry):
    kind: str = Field(min_length=1)
    severity: Severity
    message: str
    advice: str = ""
    data: dict[str, Number | list[int]] = Field(default_factory=dict)


class _StatedEntry(Entry):
    verdict: _VerdictEntry | None = None
    findings: list[_FindingEntry] = Field(default_factory=list)


def verdict_entries(verdict: Verdict) -> dict[str, Any]:
    """Keys for a calibration file, or for the file that replaces it after a refusal: the verdict, and all findings."""
    stated: dict[str, Any] = {
        "grade": verdict.grade,
        "headline": verdict.headline,
        "reasons": [*verdict.reasons],
        "advice": verdict.advice,
    }
    present = {finding.kind for finding in verdict.findings}
    if kinds := [kind.name for kind in verdict.kinds if kind in present]:
        stated["kinds"] = kinds
    return {"verdict": stated, "findings": finding_entries(verdict.findings)}


def finding_entries(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """The findings as values of a file, without numbers that are not finite."""
    return [
        {
            "kind": finding.kind.name,
            "severity": finding.severity.value,
            "message": finding.message,
            "advice": finding.advice,
            "data": {name: _plain(datum) for name, datum in finding.data.items() if _is_finite(datum)},
        }
        for finding in findings
    ]


def _plain(datum: Datum) -> float | list[int]:
    return [int(number) for number in datum] if isinstance(datum, tuple) else float(f"{datum:.{_SIGNIFICANT_DIGITS}g}")


def _is_finite(datum: Datum) -> bool:
    return isinstance(datum, tuple) or isfinite(datum)


def write_refusal(path: Path, entries: Mapping[str, Any]) -> None:
    """Write why a capture was refused, for programs: the page says it to people. Raises OSError."""
    path.write_text(block_yaml(entries), encoding="utf-8")


def read_verdict(path: Path) -> Verdict | None:
    """Read the verdict and the findings from a result's calibration file, or from that of a refusal.

    Returns None without a verdict, as in older files. Raises InputError.
    """
    stated = validate(_StatedEntry, read_yaml(path), str(path))
    if stated.verdict is None:
        return None
    entry = stated.verdict
    findings = tuple(_finding(finding) for finding in stated.findings)
    kinds = tuple(FindingKind(name, "") for name in entry.kinds)
    return Verdict(entry.grade, entry.headline, tuple(entry.reasons), entry.advice, findings, kinds)


def _finding(entry: _FindingEntry) -> Finding:
    """A finding of any kind, also of one that this version does not know."""
    data: dict[str, Datum] = {
        name: tuple(datum) if isinstance(datum, list) else datum for name, datum in entry.data.items()
    }
    return Finding(FindingKind(entry.kind, "", data=tuple(data)), entry.severity, entry.message, entry.advice, data)


def verdict_of(folder: Path) -> Verdict | None:
    """The verdict of a result, or of a refusal; None where no file says one. Raises InputError."""
    files = (folder / name for name in (REFUSAL_FILE, CALIBRATION_FILE, NETWORK_FILE))
    path = next((path for path in files if path.is_file()), None)
    return None if path is None else read_verdict(path)
