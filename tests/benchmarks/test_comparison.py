"""The comparison of two checkouts: what is a difference, and that its cases have what they need."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from comparison.cases import CASES, recordings_in
from comparison.differences import differences, folder_differences
from comparison.inputs import INPUTS
from hypothesis import given
from hypothesis import strategies as st

from tests.support.places import ROOT

TOLERANCE = 1e-9


def changes(before: Any, after: Any) -> list[str]:
    return list(differences(before, after, TOLERANCE))


@given(st.floats(1e-200, 1e200), st.sampled_from((-1, 1)), st.floats(0.0, 1e-5))
def test_a_number_differs_beyond_the_tolerance_of_its_size(size: float, sign: int, relative: float) -> None:
    change = changes({"number": sign * size}, {"number": sign * size * (1 + relative)})
    if relative < 0.99 * TOLERANCE:
        assert change == []
    elif relative > 1.01 * TOLERANCE:
        assert len(change) == 1
        assert change[0].startswith("number differs: ")


def test_each_number_of_an_array_counts_by_its_own_size() -> None:
    values = np.array([1e6, 3.0, -2.0])
    assert changes(values, values + np.array([0.0, 1e-9, -1e-9])) == []
    assert changes(values, values + np.array([0.0, 6e-9, 0.0])) == [
        "differs: 1 of 3 numbers, 3 is now 3.000000006, off by 2e-09 of its size"
    ]


@pytest.mark.parametrize(("step", "count"), [(0.5e-16, 0), (4e-16, 1)])
def test_rounding_of_the_largest_number_is_no_difference(step: float, count: int) -> None:
    assert len(changes([1.0, 1e-20], [1.0, 1e-20 + step])) == count


@pytest.mark.parametrize(("steps", "count"), [(1, 0), (3, 1)])
def test_single_precision_may_be_one_step_off(steps: int, count: int) -> None:
    before = np.array([1.5, -700.0], np.float32)
    after = before.copy()
    for _ in range(steps):
        after = np.nextafter(after, np.float32(1e9))
    assert len(changes(before, after)) == count


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (np.nan, 1.0),
        ([0.0, 1.0], [0.0, np.nan]),
        (np.inf, -np.inf),
        (0.0, 1e-300),
        (1, "1"),
        (None, 0.0),
        (True, False),
        (b"\x00\x01", b"\x00\x02"),
        (np.zeros(3), np.zeros(4)),
        (np.zeros((3, 1)), np.zeros(3)),
        ([1, [2, 3]], [1, [2, 4]]),
    ],
)
def test_what_is_not_the_same_is_one_difference(before: Any, after: Any) -> None:
    assert len(changes(before, after)) == 1
    assert changes(before, before) == changes(after, after) == []


def test_parts_that_only_one_has_and_changed_words_are_named() -> None:
    before = {"notes": ["all is well"], "old": {"a": 1, "b": 2}}
    after = {"notes": ["all is very well", "more"], "findings": [{"kind": "dark"}]}
    assert changes(before, after) == [
        "notes has 1 entries before, 2 after",
        "notes.0 “” is now “very”",
        "old is only before",
        "findings is only after",
    ]


def written(folder: Path, focal: float = 1.0, date: str = "2026-01-01T10:00:00+00:00") -> Path:
    """A result folder as the program leaves it, with numbers in every kind of file."""
    folder.mkdir()
    (folder / "calibration.yaml").write_text(yaml.safe_dump({"made": {"date": date}, "focal_px": [focal, 2.0]}))
    (folder / "scan.log").write_text(f"{date[:10]} 10:00:00,123 INFO scanner.{date[8:10]}: Focal length {focal}\n")
    (folder / "rows.csv").write_text(f"name,focal,started\nroom,{focal},{date}\n")
    (folder / "report.html").write_text(f"<p>Made {date[:10]}, 10:00 UTC</p><script>{focal}</script><b>{focal}</b>")
    (folder / "plan.svg").write_text(f'<svg><path d="M0 {focal}L3 4"/></svg>')
    np.savez(folder / "matches.npz", camera_px=np.full((3, 2), focal))
    ply = "ply\nformat binary_little_endian 1.0\ncomment unit m\nelement vertex 2\nproperty float x\nend_header\n"
    (folder / "cloud.ply").write_bytes(ply.encode() + np.array([focal, 7], "<f4").tobytes())
    cv2.imwrite(str(folder / "frame.png"), np.full((4, 4), round(100 * focal), np.uint8))
    (folder / "unknown.kind").write_text(str(focal))
    return folder


def test_a_changed_number_is_found_in_every_kind_of_file(tmp_path: Path) -> None:
    before, after = written(tmp_path / "before"), written(tmp_path / "after", focal=1.03125)
    reports = list(folder_differences(before, after, TOLERANCE))
    changed = [report.partition(": ")[0] for report in reports]
    assert set(changed) == {path.name for path in before.iterdir()}
    assert changed.count("report.html") == 2  # in its words, and in its script
    assert list(folder_differences(before, before, TOLERANCE)) == []


def test_times_are_no_differences(tmp_path: Path) -> None:
    before, after = written(tmp_path / "before"), written(tmp_path / "after", date="2027-12-31T10:00:01+00:00")
    assert list(folder_differences(before, after, TOLERANCE)) == []


def refused(folder: Path, checkout: str, reason: str) -> Path:
    """A result folder with the log of a refusal."""
    folder.mkdir()
    frames = "".join(
        f'  File "{checkout}/calib/{name}.py", line {len(checkout)}, in solve\n    {name}()\n' for name in "ab"
    )
    (folder / "scan.log").write_text(
        f"ERROR: refused\nTraceback (most recent call last):\n{frames}RefusalError: {reason}\n"
    )
    return folder


def test_where_a_refusal_was_raised_is_no_difference_but_its_reason_is(tmp_path: Path) -> None:
    before, after = refused(tmp_path / "before", "/old", "dark"), refused(tmp_path / "after", "/newer", "dark")
    assert list(folder_differences(before, after, TOLERANCE)) == []
    other = refused(tmp_path / "other", "/old", "bright")
    assert list(folder_differences(before, other, TOLERANCE)) == [
        "scan.log: “RefusalError: dark” is now “RefusalError: bright”"
    ]


def test_files_that_only_one_has_are_named(tmp_path: Path) -> None:
    before, after = written(tmp_path / "before"), written(tmp_path / "after")
    (before / "cloud.ply").unlink()
    (after / "plan.svg").unlink()
    assert list(folder_differences(before, after, TOLERANCE)) == ["cloud.ply is only after", "plan.svg is only before"]


@pytest.mark.parametrize("name", CASES)
def test_every_case_has_its_inputs(name: str) -> None:
    command = CASES[name].command
    assert set(re.findall(r"\bold/([\w-]+)", command)) <= set(CASES)
    for made in re.findall(r"\binputs/([\w-]+)", command):
        assert set(INPUTS[made].cases) <= set(CASES)
    for config in re.findall(r"configs/\S+", command):
        assert (ROOT / config).is_file()


def test_recordings_are_replayed_with_the_calibration_beside_them(tmp_path: Path) -> None:
    for name in ("plain", "known"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "capture.yaml").touch()
    (tmp_path / "known" / "calibration.yaml").touch()
    cases = recordings_in([tmp_path])
    assert list(cases) == ["recording-known", "recording-plain"]
    assert "--calibration" in cases["recording-known"].command
    assert "--calibration" not in cases["recording-plain"].command
