"""`scan check` for an operator: exit codes, output, and files."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

import pytest
import yaml
from rich.console import Console

from calib.finding import Finding, Severity
from calib.refusal import RefusalError
from hw.aravis import AravisRigSettings
from hw.errors import DeviceError, OverexposedError
from hw.open_rig import OpenedRig
from hw.simulated import SimulatedRoom
from scanner.checking import check_configured_rig, devices
from scanner.checking.report import CheckReport, CheckRow, table_of
from scanner.commands import check as command
from scanner.commands import main
from scanner.configuration import load_config
from scanner.ui import Terminal
from tests.support.findings import FOR_TESTS
from tests.support.rig_bench import OVERRIDES, PERIOD_US, changed, rig_in

pytestmark = pytest.mark.xdist_group("checking")  # what the module shares is made once

TEXT = "# My rig\nrig:\n  backend: simulated   # a room\n  seed: 0\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(TEXT + "".join(f"{key}: {value}\n" for key, _, value in map(split, OVERRIDES[1:3])))
    return path


def split(override: str) -> tuple[str, str, str]:
    return override.partition("=")


def run(*arguments: object) -> int:
    return main(["check", *map(str, arguments)])


@pytest.fixture
def report(monkeypatch: pytest.MonkeyPatch, usual: CheckReport) -> CheckReport:
    """The report that the command gets instead of running a check."""
    monkeypatch.setattr(command, "check_configured_rig", lambda *_: usual)
    return usual


def finding(
    monkeypatch: pytest.MonkeyPatch, rows: tuple[CheckRow, ...], failure: DeviceError | RefusalError | None
) -> None:
    monkeypatch.setattr(command, "check_configured_rig", lambda *_: CheckReport(list(rows), failure=failure))


def test_the_table_shows_the_findings(path: Path, report: CheckReport, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--config", path) == 0
    text = " ".join(capsys.readouterr().out.split())
    for word in ("✓ ok", "gamma 2.20", "refresh period", "focal lengths will be known to about"):
        assert word in text
    assert path.read_text().startswith(TEXT)


def test_quiet_prints_nothing(path: Path, report: CheckReport, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--config", path, "--quiet", "--write") == 0
    assert capsys.readouterr() == ("", "")


def test_write_puts_exposure_and_response_into_the_file(
    path: Path, report: CheckReport, capsys: pytest.CaptureFixture[str]
) -> None:
    before = path.read_text()
    assert run("--config", path, "--write") == 0
    assert "room.yaml.bak" in capsys.readouterr().out
    after = path.read_text()
    assert [line for line in after.splitlines() if line in before] == [
        line for line in before.splitlines() if not line.startswith("projector")
    ]
    config = load_config(path)
    assert config.rig.exposure_us == pytest.approx(report.exposure_us, abs=0.1)
    assert config.rig.exposure_us / PERIOD_US == pytest.approx(1, abs=1e-4)
    assert config.projector.known_response.gamma == pytest.approx(2.2, abs=0.03)
    assert path.with_name("room.yaml.bak").read_text() == before


def test_writing_twice_changes_nothing(path: Path, report: CheckReport) -> None:
    assert run("--config", path, "--write") == 0
    once = path.read_text()
    assert run("--config", path, "--write") == 0
    assert path.read_text() == once


def test_out_keeps_pictures_and_rows(path: Path, report: CheckReport, tmp_path: Path) -> None:
    out = tmp_path / "check"
    assert run("--config", path, "--out", out, "--quiet") == 0
    document = yaml.safe_load((out / "check.yaml").read_text())
    assert document["state"] == "ok"
    assert [row["name"] for row in document["rows"]] == [row.name for row in report.rows]
    assert sorted(file.name for file in out.iterdir()) == ["check.yaml", *sorted(document["pictures"])]
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in document["pictures"])
    assert run("--config", path, "--out", out) == 2


@pytest.mark.parametrize(
    ("failure", "code"),
    [
        (None, 0),
        (DeviceError("camera x: gone. Check cable."), 3),
        (RefusalError(FOR_TESTS, "The faces are flat.", "Turn the rig."), 4),
    ],
)
def test_exit_codes(
    path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    failure: DeviceError | RefusalError | None,
    code: int,
) -> None:
    rows = (
        CheckRow("camera", Finding(FOR_TESTS, Severity.NOTE, "here")),
        CheckRow("focus", Finding(FOR_TESTS, Severity.WARNING, "blurred", "Focus the camera.")),
    )
    finding(monkeypatch, rows, failure)
    assert run("--config", path) == code
    captured = capsys.readouterr()
    assert "here" in captured.out
    assert "→ Focus the camera." in captured.out
    assert (str(failure) in captured.err) if failure else (captured.err == "")


@pytest.mark.parametrize(
    ("severity", "required", "code"),
    [
        (Severity.WARNING, "good", 4),
        (Severity.WARNING, "fair", 0),
        (Severity.NOTE, "good", 0),
    ],
)
def test_a_check_can_be_required_to_find_nothing_poor(
    path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    severity: Severity,
    required: str,
    code: int,
) -> None:
    finding(monkeypatch, (CheckRow("focus", Finding(FOR_TESTS, severity, "blurred", "Focus.")),), None)
    assert run("--config", path, "--require", required) == code
    captured = capsys.readouterr()
    assert "blurred" in captured.out
    assert ("1 thing could be better" in captured.err) == (code == 4)


def test_without_a_finding_nothing_is_written(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = path.read_text()
    finding(monkeypatch, (), DeviceError("gone"))
    assert run("--config", path, "--write") == 3
    assert path.read_text() == before
    assert "is unchanged" in capsys.readouterr().out
    assert not path.with_name("room.yaml.bak").exists()


def test_an_absent_camera_is_reported(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise DeviceError("camera: no camera answers to 'x'. Found: none. Check power and cable.")

    monkeypatch.setattr(devices, "open_rig", refuse)
    assert run("--config", path) == 3
    captured = capsys.readouterr()
    assert "✗ failed" in captured.out
    assert "no camera answers" in captured.err
    assert "Traceback" not in captured.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rig: {backend: aravis}\n", "camera.width"),
        ("camera: {width: 64, height: 48}\nprojector: {width: 64, height: 48}\n", "has no 'rig'"),
        ("rig: {backend: aravi}\n", "rig.backend"),
        ("rig: {backend: simulated, expose: 5}\n", "did you mean"),
        ("projector: {width: 64, height: 48, response: [0, 2, 1]}\n", "rise from 0 to 1"),
    ],
)
def test_a_wrong_configuration_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    assert run("--config", path) == 2
    assert words in capsys.readouterr().err


def test_an_overexposed_rig_is_reopened_with_a_shorter_exposure(
    monkeypatch: pytest.MonkeyPatch, room: SimulatedRoom
) -> None:
    asked = []

    @contextmanager
    def opening(settings: AravisRigSettings, *_: object) -> Iterator[OpenedRig]:
        asked.append(settings.exposure_us)
        if settings.exposure_us > 12_000:
            raise OverexposedError("everything that white lights is overexposed")
        yield OpenedRig(rig_in(changed(room)), None)

    monkeypatch.setattr(devices, "open_rig", opening)
    aravis = load_config(None, (*OVERRIDES, "rig={backend: aravis, exposure_us: 160000}"))
    with devices.opened(aravis) as rig:
        assert rig.camera.size == (306, 256)
    assert asked == [160_000, 40_000, 10_000]


def test_a_rig_that_stays_overexposed_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OverexposedError("everything that white lights is overexposed")

    monkeypatch.setattr(devices, "open_rig", refuse)
    report = check_configured_rig(load_config(None, (*OVERRIDES, "rig={backend: aravis}")), Terminal(quiet=True))
    assert isinstance(report.failure, DeviceError)


@pytest.mark.parametrize(("encoding", "sign"), [("utf-8", "✓"), ("ascii", "+"), (None, "+"), ("cp1252", "+")])
def test_terminals_without_unicode_get_plain_symbols(encoding: str | None, sign: str) -> None:
    report = CheckReport([CheckRow("focus", Finding(FOR_TESTS, Severity.NOTE, "sharp [all]", "Nothing."))])
    out = StringIO()
    Console(file=out, width=80).print(table_of(report, encoding))
    assert f"{sign} ok" in out.getvalue()
    assert "sharp [all]" in out.getvalue()
    assert ("→" in out.getvalue()) == (sign == "✓")


def test_help_explains_the_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run("--help")
    text = capsys.readouterr().out
    assert "--write" in text
    assert "Exit codes" in text
