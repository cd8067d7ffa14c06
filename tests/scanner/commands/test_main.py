"""The command line: arguments in, exit code and messages out. Slow functions are replaced."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from shutil import rmtree

import numpy as np
import pytest

from calib.geometry import Calibration, Intrinsics, Pose
from calib.refusal import RefusalError
from hw.errors import DeviceError
from scanner import jobs
from scanner.io import write_calibration
from scanner.patterns import sequence_for, write_sequence
from tests.support.command_line import run
from tests.support.findings import FOR_TESTS
from tests.support.places import ROOT
from tests.support.small_capture import SIZE, read_listing, write_listing

CONFIG = "camera: {width: 48, height: 32}\nprojector: {width: 48, height: 32}\nrig: {backend: simulated}\n"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        run("--help")
    assert caught.value.code == 0
    text = capsys.readouterr().out
    for word in (
        "--config",
        "--out",
        "--masks",
        "--overwrite",
        "--quiet",
        "replay",
        "calibrate",
        "patterns",
        "devices",
    ):
        assert word in text


@pytest.mark.parametrize("command", ["replay", "calibrate", "patterns", "devices"])
def test_each_command_has_help(capsys: pytest.CaptureFixture[str], command: str) -> None:
    with pytest.raises(SystemExit) as caught:
        run(command, "--help")
    assert caught.value.code == 0
    assert f"usage: scan {command}" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        run("--version")
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith("scan 0.")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("nothing to do", "usage: scan", "replay")),
        (("frobnicate",), ("unknown command 'frobnicate'", "--config FILE", "replay, calibrate, ")),
        (("mesure",), ("unknown command 'mesure'", "did you mean 'scan measure'?")),
        ((".",), ("'.' is no command", "scan view ., scan measure ., scan export ., scan replay .")),
        (("--confg", "room.yaml"), ("--config", "scan --help")),
        (("--out", "room"), ("--config",)),
        (("--config", "missing.yaml"), ("missing.yaml", "no such file")),
        (("replay",), ("CAPTURE", "scan replay --help")),
        (("replay", "nowhere"), ("nowhere", "no such capture folder")),
        (("replay", "a", "b"), ("unrecognized arguments: b",)),
        (("calibrate", "m.npz"), ("--config, --out",)),
        (("patterns", "--config", "room.yaml"), ("--out",)),
    ],
)
def test_wrong_arguments(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("scan: ")
    for word in words:
        assert word in output.err
    assert list(tmp_path.iterdir()) == []


def truncate_frame(capture: Path) -> None:
    frame = capture / "frames/004.png"
    frame.write_bytes(frame.read_bytes()[:-20])


def forget_the_y_patterns(capture: Path) -> None:
    listing = read_listing(capture)
    for entry in listing["frames"]:
        if entry["pattern"].get("axis") == "y":
            (capture / entry["file"]).unlink()
    listing["frames"] = [entry for entry in listing["frames"] if entry["pattern"].get("axis") != "y"]
    write_listing(capture, listing)


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (lambda capture: rmtree(capture / "frames"), ("000.png", "missing")),
        (lambda capture: (capture / "capture.yaml").write_text("frames: 3"), ("'frames'", "'format' is missing")),
        (truncate_frame, ("004.png", "truncated")),
        (forget_the_y_patterns, ("y",)),
    ],
)
def test_a_broken_capture_leaves_nothing_behind(
    tmp_path: Path,
    capture_folder: Path,
    capsys: pytest.CaptureFixture[str],
    break_it: Callable[[Path], object],
    words: tuple[str, ...],
) -> None:
    break_it(capture_folder)
    out = tmp_path / "results" / "room"
    assert run("replay", capture_folder, "--out", out) == 2
    assert not out.parent.exists()
    output = capsys.readouterr()
    assert output.out == ""
    assert "Traceback" not in output.err
    for word in words:
        assert word in output.err


def test_a_calibration_of_another_size_is_refused(
    tmp_path: Path, capture_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    device = Intrinsics(64, 32, (50, 50), (24, 16))
    calibration = tmp_path / "calibration.yaml"
    write_calibration(calibration, Calibration(device, device, Pose(np.eye(3), np.array([1.0, 0, 0]))))
    assert run("replay", capture_folder, "--calibration", calibration, "--out", tmp_path / "out") == 2
    assert "camera is 64 × 32, but the capture's is 48 × 32" in capsys.readouterr().err


def test_masks_and_calibration_exclude_each_other(
    tmp_path: Path, capture_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("replay", capture_folder, "--masks", tmp_path, "--calibration", tmp_path, "--out", tmp_path / "o") == 2
    assert "give one of them" in capsys.readouterr().err


def test_a_known_principal_point_of_another_image_size_is_refused(
    tmp_path: Path, capture_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "other.yaml"
    config.write_text("camera: {width: 640, height: 480, principal_point: {known: [320, 240]}}")
    assert run("replay", capture_folder, "--config", config, "--out", tmp_path / "out") == 2
    assert "640 × 480" in capsys.readouterr().err


def test_patterns_are_written(tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("patterns", "--config", config, "--set", "sequence.shifts=3", "--out", tmp_path / "patterns") == 0
    assert "patterns of 48 × 32 pixels" in capsys.readouterr().out
    (tmp_path / "expected").mkdir()
    write_sequence(tmp_path / "expected", sequence_for(SIZE, shifts=3), SIZE)
    for path in (tmp_path / "expected").rglob("*.*"):
        assert (tmp_path / "patterns" / path.relative_to(tmp_path / "expected")).read_bytes() == path.read_bytes()


def test_patterns_do_not_overwrite(tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("patterns", "--config", config, "--quiet", "--out", tmp_path / "patterns") == 0
    assert run("patterns", "--config", config, "--quiet", "--out", tmp_path / "patterns") == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "already exists" in output.err


def fail_after_two_frames(error: BaseException) -> Callable[..., object]:
    def failing(config: object, folder: Path, *_: object, **__: object) -> None:
        (folder / "capture/frames").mkdir(parents=True)
        for index in range(2):
            (folder / f"capture/frames/{index:03d}.png").touch()
        raise error

    return failing


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (DeviceError("the camera was unplugged"), 3, ("the camera was unplugged", "2 frames captured so far")),
        (KeyboardInterrupt(), 130, ("interrupted", "2 frames captured so far")),
        (OSError(28, "No space left on device"), 3, ("room: cannot", "No space left", "2 frames captured so far")),
        (
            RefusalError(FOR_TESTS, "No corner.", "Find one."),
            4,
            ("no trustworthy calibration", "No corner. Find one.", "The recording is in"),
        ),
    ],
)
def test_exit_codes_of_a_live_scan(
    tmp_path: Path,
    config: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    words: tuple[str, ...],
) -> None:
    monkeypatch.setattr(jobs, "take_captures", fail_after_two_frames(error))
    assert run("--config", config, "--out", tmp_path / "room") == code
    output = capsys.readouterr()
    assert output.out == ""
    assert "Traceback" not in output.err
    for word in words:
        assert word in output.err
    assert (tmp_path / "room").exists() == (code == 4)
    assert (tmp_path / "room-incomplete").exists() == (code != 4)


def test_a_bug_is_reported_with_a_file_that_holds_its_traceback(
    tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jobs, "take_captures", fail_after_two_frames(ZeroDivisionError("oops")))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run("--config", config, "--out", tmp_path / "room") == 70
    message = capsys.readouterr().err
    assert "a bug in this program: ZeroDivisionError: oops" in message
    (file,) = tmp_path.glob("scan-*.log")
    assert str(file) in message
    assert "Traceback" not in message
    assert "Traceback" in file.read_text()


def test_everything_is_checked_before_the_capture(
    tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jobs, "take_captures", fail_after_two_frames(AssertionError("the capture has begun")))
    occupied = tmp_path / "occupied"
    occupied.mkdir()
    (occupied / "thesis.tex").touch()
    for more, words in (
        (["--out", occupied], "already exists"),
        (["--masks", tmp_path / "masks"], "no such folder of masks"),
        (["--set", "camera.principal_point={known: [1e4, 1]}"], "far outside"),
        (["--set", "camera={}"], "'camera.width'"),
        (["--set", "sequence.cell=64"], "sequence"),
    ):
        assert run("--config", config, *more) == 2
        assert words in capsys.readouterr().err


@pytest.mark.parametrize("command", ["patterns", "import", "replay"])
def test_only_commands_with_overwrite_replace_results(
    tmp_path: Path, config: Path, capture_folder: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    more = ["--config", config] if command == "patterns" else [capture_folder]
    assert run(command, *more, "--out", tmp_path) == 2
    message = capsys.readouterr().err
    assert "already exists; choose another --out" in message
    assert ("--overwrite" in message) == (command == "replay")


@pytest.mark.parametrize(("section", "words"), [("rig", "'rig'"), ("projector", "'projector")])
def test_missing_settings_of_a_scan_are_named(
    tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str], section: str, words: str
) -> None:
    config.write_text("".join(line for line in CONFIG.splitlines(keepends=True) if not line.startswith(section)))
    assert run("--config", config, "--out", tmp_path / "room") == 2
    assert words in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["room.yaml"]


def test_the_module_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "scanner", "device"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("scan: unknown command 'device'")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments", [["--help"], ["replay", "--help"], ["--confg", "room.yaml"], ["replay", "--bogus"]]
)
def test_help_and_typing_errors_load_nothing_heavy(arguments: list[str]) -> None:
    """They respond at once (benchmarks/bench_startup.py measures it)."""
    program = (
        "import sys; from scanner.commands.main import main\n"
        f"try: main({arguments!r})\nexcept SystemExit: pass\n"
        "print(*sorted({'numpy', 'cv2', 'numba', 'scipy', 'pydantic'} & set(sys.modules)), file=sys.stderr)"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert told.stderr.splitlines()[-1] == ""


@pytest.mark.parametrize("allowed_kb", [300_000, 500_000, 850_000, 1_000_000, 1_200_000])
def test_without_address_space_for_its_libraries_it_says_so(config: Path, allowed_kb: int) -> None:
    """Between these limits libraries cannot be loaded, end the process, or get no thread."""
    command = f'ulimit -v {allowed_kb}; exec "$0" -m scanner --config "$1"'
    process = subprocess.run(
        ["sh", "-c", command, sys.executable, config], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert process.returncode == 2
    assert f"may use {allowed_kb * 1024 / 1e9:.2f} GB of address space" in process.stderr
    assert process.stderr.count("\n") == 1
