"""Which captures a batch consists of."""

import json
from pathlib import Path
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.batch import listing
from scanner.batch.listing import BatchRequest, list_jobs
from scanner.batch.rows import BatchRow
from scanner.configuration import load_config
from scanner.errors import InputError


def capture(folder: Path) -> Path:
    (folder / "frames").mkdir(parents=True)
    (folder / "capture.yaml").write_text("format: 1")
    (folder / "frames" / "capture.yaml").write_text("no capture: frames are not looked into")
    return folder


@pytest.fixture
def museum(tmp_path: Path) -> Path:
    for name in ("hall/b", "hall/a", "vase/capture", "yard"):
        capture(tmp_path / "museum" / name)
    return tmp_path / "museum"


def test_captures_below_a_folder_are_named_by_their_relative_paths(museum: Path) -> None:
    jobs = list_jobs([str(museum)], BatchRequest())
    assert [job.name for job in jobs] == ["hall/a", "hall/b", "vase", "yard"]
    assert [Path(job.capture) for job in jobs] == [
        museum / name for name in ("hall/a", "hall/b", "vase/capture", "yard")
    ]


def test_single_captures_and_glob_patterns(museum: Path) -> None:
    assert [job.name for job in list_jobs([str(museum / "yard")], BatchRequest())] == ["yard"]
    assert [job.name for job in list_jobs([str(museum / "h*" / "*")], BatchRequest())] == ["a", "b"]


def test_captures_of_the_same_name_are_distinguished_and_listed_once(museum: Path) -> None:
    capture(museum / "other" / "a")
    jobs = list_jobs([str(museum / "hall"), str(museum / "other"), str(museum / "hall" / "a")], BatchRequest())
    assert [(job.name, Path(job.capture).parent.name) for job in jobs] == [
        ("a", "hall"),
        ("a-2", "other"),
        ("b", "hall"),
    ]


def test_a_list_gives_each_capture_its_options(museum: Path) -> None:
    (museum / "rig.yaml").write_text("corner: {squareness_deg: 0.1}\n")
    (museum / "known.yaml").write_text("text of a calibration")
    (museum / "list.csv").write_text(
        "capture,name,config,calibration,set\n"
        "hall/a,first,rig.yaml,,\n"
        f"{museum}/hall/b,,,known.yaml,\n"
        "yard,,rig.yaml,,corner.squareness_deg=0.2; method=paper\n"
    )
    b, first, yard = list_jobs([str(museum / "list.csv")], BatchRequest(overrides=("method=refined",)))
    assert (first.name, first.config.corner.squareness_deg, first.calibration) == ("first", 0.1, None)
    assert (b.name, b.config.corner.squareness_deg, b.calibration) == ("b", None, "text of a calibration")
    assert (yard.name, yard.config.corner.squareness_deg, yard.config.method) == ("yard", 0.2, "paper")


def test_a_list_reads_shared_files_once(museum: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Mock(wraps=load_config)
    monkeypatch.setattr(listing, "load_config", counted)
    (museum / "list.csv").write_text("capture,set\nhall/a,\nhall/b,\nyard,method=paper\n")
    jobs = list_jobs([str(museum / "list.csv")], BatchRequest())
    assert [job.config.method for job in jobs] == ["refined", "refined", "paper"]
    assert [read.args for read in counted.call_args_list] == [(None, ()), (None, ("method=paper",))]


def test_the_digest_of_a_task_changes_with_every_relevant_input(museum: Path) -> None:
    plain = list_jobs([str(museum)], BatchRequest())
    assert [job.asked for job in list_jobs([str(museum)], BatchRequest())] == [job.asked for job in plain]
    (museum / "known.yaml").write_text("text")
    for other in (BatchRequest(overrides=("method=paper",)), BatchRequest(calibration=str(museum / "known.yaml"))):
        changed = list_jobs([str(museum)], other)
        assert not {job.asked for job in changed} & {job.asked for job in plain}


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_endings_of_any_system_are_read(museum: Path, end: str) -> None:
    (museum / "list.csv").write_bytes(end.join(["capture,name", "hall/a,first", "yard,last", ""]).encode())
    assert [job.name for job in list_jobs([str(museum / "list.csv")], BatchRequest())] == ["first", "last"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name\nx\n", "'capture' at least"),
        ("capture,colour\nhall/a,red\n", "found capture, colour"),
        ("capture,name\n,x\n", "line 2: no capture is named"),
        ("capture,name\nhall/a,../../outside\n", r"expected a name below the results, found '\.\./\.\./outside'"),
        ("capture,name\nhall/a,/outside\n", "expected a name below the results"),
        ("capture,name\nhall/a,.\n", "expected a name below the results"),
        ("capture,name\nhall/a,\x1b[31mred\n", "line 2: a name has a control character"),
        ('capture,name\nhall/a,"two\nlines"\n', "line 2: a name has a control character"),
        ("capture,name\nhall/\u202ea,x\n", "line 2: a name has a control character"),
        (f"capture,name\nhall/a,{'x' * 300}\n", "expected a name below the results"),
        (f"capture\nhall/a\n{'x' * 200_000}\n", "line 3: not a table of values"),
        (f"capture,config\nhall/a,{'x' * 300}.yaml\n", "yaml: cannot be read"),
        ("capture,calibration\nhall/a,/dev/zero\n", "/dev/zero: is a device"),
        ("capture,calibration\nhall/a,zip://a::b\n", "cannot be reached"),
        ("capture,name\nhall/a,hall\nyard,hall/yard\n", "'hall' and 'hall/yard', one result inside of the other"),
        ("capture\n", "found none"),
        ("capture,set\nhall/a,cornr.same=1\n", "cornr"),
    ],
)
def test_a_malformed_list_is_refused(museum: Path, text: str, message: str) -> None:
    (museum / "list.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        list_jobs([str(museum / "list.csv")], BatchRequest())


@pytest.mark.parametrize("source", ["nothing-there", "nothing-*", "nothing.csv"])
def test_nothing_to_do_is_an_error(tmp_path: Path, source: str) -> None:
    (tmp_path / "empty").mkdir()
    for wanted in (tmp_path / source, tmp_path / "empty"):
        with pytest.raises(InputError, match=r"none|no such|cannot be read"):
            list_jobs([str(wanted)], BatchRequest())


_numbers = st.none() | st.floats(allow_nan=False, allow_infinity=False)


@given(st.text(), st.integers(0, 255), st.none() | st.text(), _numbers, st.none() | st.integers(0, 2**63 - 1))
def test_a_row_reads_back_the_same(
    name: str, code: int, reason: str | None, residual: float | None, matches: int | None
) -> None:
    row = BatchRow(name, "capture", "result", code, reason=reason, residual_px=residual, matches=matches)
    assert BatchRow.from_json(row.to_json(), "here") == row


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'{"name": "x"}', b"\xff", b"3", b"[" * 100_000])
def test_a_malformed_row_is_ignored(data: bytes) -> None:
    with pytest.raises(InputError, match="here: expected a row"):
        BatchRow.from_json(data, "here")


@pytest.mark.parametrize(
    ("name", "value"), [("seconds", "x"), ("exit_code", "0"), ("matches", 10**30), ("grade", "<b>"), ("name", ["x"])]
)
def test_a_row_with_impossible_values_is_ignored(name: str, value: object) -> None:
    changed = json.loads(BatchRow("x", "capture", "result", 0).to_json()) | {name: value}
    with pytest.raises(InputError, match=r"here: expected a row of a batch"):
        BatchRow.from_json(json.dumps(changed).encode(), "here")
