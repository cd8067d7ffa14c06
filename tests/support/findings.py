"""Findings by the names of their kinds, as scripts read them."""

from collections.abc import Iterable

from calib.finding import Finding, FindingKind

FOR_TESTS = FindingKind("for-tests", "Something was found.", "Do something.")


def kinds_of(findings: Iterable[Finding]) -> list[str]:
    """The names of the findings' kinds, in their order."""
    return [finding.kind.name for finding in findings]


def the_only(kind: str, findings: Iterable[Finding]) -> Finding:
    """The finding of this kind; there must be exactly one."""
    (finding,) = (finding for finding in findings if finding.kind.name == kind)
    return finding
