"""Verdicts and findings are read back as they were written, also those of kinds that this version does not know."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calib.finding import Finding, FindingKind, Severity
from scanner.errors import InputError
from scanner.results import REFUSAL_FILE, Verdict, read_verdict, verdict_entries, verdict_of, write_refusal

FLICKER = FindingKind("flicker", "Lamps flicker.", data=("flicker_share", "frames"))
GHOST = FindingKind("ghost", "Frames show some of the picture before theirs.")
FLICKERING = Finding(
    FLICKER, Severity.WARNING, "It flickers: “much”.", "# Stop.", {"flicker_share": 0.125, "frames": (1, 2)}
)
GHOSTLY = Finding(GHOST, Severity.NOTE, "It is haunted.")
VERDICT = Verdict("fair", "Calibrated", ("± 3 %", "It is haunted."), "Once more.", (FLICKERING, GHOSTLY), (GHOST,))

texts = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), max_size=20)
names = st.text("abcdefghijklmnopqrstuvwxyz_-", min_size=1, max_size=12)
numbers = st.floats(-1e6, 1e6).map(lambda number: float(f"{number:.6g}"))
data = st.dictionaries(names, numbers | st.lists(st.integers(0, 999), max_size=4).map(tuple), max_size=3)
findings = st.builds(
    lambda name, severity, message, advice, data: Finding(
        FindingKind(name, "", data=tuple(data)), severity, message, advice, data
    ),
    names,
    st.sampled_from(Severity),
    texts,
    texts,
    data,
)


def test_a_verdict_reads_back_with_its_findings(tmp_path: Path) -> None:
    write_refusal(tmp_path / REFUSAL_FILE, verdict_entries(VERDICT))
    read = verdict_of(tmp_path)
    assert read == VERDICT
    assert read.further == (FLICKERING,), "the other one is among the reasons"


@given(given_findings=st.lists(findings, max_size=4))
def test_any_finding_reads_back(tmp_path_factory: pytest.TempPathFactory, given_findings: list[Finding]) -> None:
    path = tmp_path_factory.mktemp("result") / "calibration.yaml"
    verdict = Verdict("good", "Well", ("so",), findings=tuple(given_findings))
    write_refusal(path, verdict_entries(verdict))
    assert read_verdict(path) == verdict


def test_the_keys_of_a_finding_are_those_of_the_format() -> None:
    entries = verdict_entries(VERDICT)
    assert entries["findings"] == [
        {
            "kind": "flicker",
            "severity": "warning",
            "message": "It flickers: “much”.",
            "advice": "# Stop.",
            "data": {"flicker_share": 0.125, "frames": [1, 2]},
        },
        {"kind": "ghost", "severity": "note", "message": "It is haunted.", "advice": "", "data": {}},
    ]
    assert entries["verdict"]["kinds"] == ["ghost"]


def test_numbers_that_are_none_are_left_out() -> None:
    kind = FindingKind("odd", "", data=("limit", "cost"))
    odd = Finding(kind, Severity.NOTE, "Odd.", data={"limit": float("inf"), "cost": 1.23456789})
    (entry,) = verdict_entries(Verdict("good", "Well", (), findings=(odd,)))["findings"]
    assert entry["data"] == {"cost": 1.23457}


def test_files_without_findings_are_valid(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text("verdict: {grade: good, headline: a, reasons: [b], advice: '', notes: [of an older version]}")
    assert read_verdict(path) == Verdict("good", "a", ("b",))
    path.write_text("camera: {width: 1}")
    assert read_verdict(path) is None


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("verdict: {grade: splendid, headline: a, reasons: [], advice: ''}", "grade"),
        ("findings: [{severity: note, message: a}]", "kind"),
        ("findings: [{kind: '', severity: note, message: a}]", "kind"),
        ("findings: [{kind: a, severity: grave, message: a}]", "severity"),
        ("findings: [{kind: a, severity: note, message: a, data: {share: much}}]", "share"),
        ("findings: [{kind: a, severity: note, message: a, data: {share: .nan}}]", "share"),
        ("findings: {kind: a}", "findings"),
    ],
)
def test_malformed_entries_are_refused(tmp_path: Path, entry: str, message: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(entry)), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_verdict(path)
