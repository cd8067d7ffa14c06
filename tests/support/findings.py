"""Findings by the names of their kinds, as scripts read them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from random import Random

import pytest

from calib.finding import Finding, FindingKind
from scanner.results import Verdict

FOR_TESTS = FindingKind("for-tests", "Something was found.", "Do something.")


def kinds_of(findings: Iterable[Finding]) -> list[str]:
    """The names of the findings' kinds, in their order."""
    return [finding.kind.name for finding in findings]


def the_only(kind: str, findings: Iterable[Finding]) -> Finding:
    """The finding of this kind; there must be exactly one."""
    (finding,) = (finding for finding in findings if finding.kind.name == kind)
    return finding


def scramble_words(patch: pytest.MonkeyPatch, seed: int = 0) -> None:
    """Let every finding have random words for its message and its advice from now on."""
    check, draw = Finding.__post_init__, Random(seed)

    def scramble(finding: Finding) -> None:
        check(finding)
        for name in ("message", "advice"):
            words = ("".join(draw.choices("aeiounrst.;: ", k=draw.randint(1, 9))) for _ in range(draw.randint(1, 5)))
            object.__setattr__(finding, name, " ".join(words))

    patch.setattr(Finding, "__post_init__", scramble)


@dataclass(frozen=True)
class Decision:
    """What a verdict decides, without its words."""

    grade: str
    kinds: tuple[tuple[str, str], ...]
    """Kind and severity of each finding."""
    said: tuple[str, ...]
    """Kinds that the reasons say."""

    @classmethod
    def of(cls, verdict: Verdict) -> "Decision":
        """Of a verdict."""
        kinds = tuple((finding.kind.name, finding.severity.value) for finding in verdict.findings)
        return cls(verdict.grade, kinds, tuple(kind.name for kind in verdict.kinds))


def decided_alike(decide: Callable[[], Verdict]) -> Decision:
    """The decision, which must be the same if every finding has random words."""
    decision = Decision.of(decide())
    with pytest.MonkeyPatch.context() as patch:
        scramble_words(patch)
        assert Decision.of(decide()) == decision
    return decision
