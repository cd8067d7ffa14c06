"""Fault × moment → what remains, and its use. Every fault is injected into a real process."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from scanner.capture import open_capture
from scanner.configuration import load_config
from scanner.decoding import Decoder, usable
from scanner.errors import InputError
from tests.support.fault_bench import FaultBench
from tests.support.places import ROOT
from tests.support.result_folder import write_result
from tests.support.small_capture import SIZE

CONFIG = "rig: {backend: simulated}\ncamera: {width: 48, height: 32}\nprojector: {width: 48, height: 32}\n"
RECORDER, RESULT, PUBLISHING = "scanner.capture.recorder", "scanner.results.result_folder", "scanner.results.unfinished"
PATTERNS = load_config(None).sequence.patterns(SIZE)
# Calls of `_append` begin with that of the header.
TAKEN = 9
# White and black, three bits along x and one along y, each with its inverse or not.
WITH_Y = 2 + 2 * 3 + 1

pytestmark = pytest.mark.xdist_group("faults")


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"room.yaml", "said.txt", "said.tree"}


def decoded(capture: Path) -> int:
    """Number of matches of an interrupted capture."""
    recording = open_capture(capture)
    sequence = usable(recording.patterns, recording.planned, recording.projector_size)
    assert f"{len(recording.patterns)} of its {len(PATTERNS)} frames were taken" in str(sequence.finding)
    stream = recording.stream().shown_as(sequence.patterns)
    decoder = Decoder(stream.patterns, stream.projector_size)
    for _, frame in stream.frames:
        decoder.add(frame.image)
    return len(decoder.finish().matches)


@dataclass(frozen=True)
class Moment:
    """Where the fault strikes, and the number of complete, listed frames then; `word`: of the message on a damaged
    frame.
    """

    name: str
    at: str
    call: int
    frames: int
    word: str = ""


BEFORE_IMAGE = Moment("before an image", f"{RECORDER}:write_png", TAKEN + 1, TAKEN)
BEFORE_LINE = Moment("between image and line", f"{RECORDER}:_append", TAKEN + 2, TAKEN, "009.png is left out")
RECORDING = [
    ("SIGKILL", BEFORE_IMAGE),
    ("SIGKILL", BEFORE_LINE),
    ("half an image", BEFORE_IMAGE),
    ("half a line", Moment("in a line", f"{RECORDER}:_append", TAKEN + 2, TAKEN, "is incomplete")),
    ("SIGKILL", Moment("between line and disk", f"{RECORDER}:_Syncing.begin", TAKEN, TAKEN)),
    ("SIGKILL", Moment("while it decodes", "scanner.decoding.decoder:Decoder.finish", 1, len(PATTERNS))),
    ("SIGKILL", Moment("in the header", f"{RECORDER}:_append", 1, 0)),
    ("SIGKILL", Moment("while the result is written", "scanner.jobs:reconstruct", 1, len(PATTERNS))),
]


@pytest.mark.parametrize(("fault", "moment"), RECORDING, ids=lambda value: getattr(value, "name", value))
def test_killed_while_recording(bench: FaultBench, config: Path, fault: str, moment: Moment) -> None:
    folder, scan = config.parent, ("--config", config, "--out", config.with_name("room"))
    planted = {"at": moment.at, "call": moment.call, "do": fault}
    assert bench.run(folder, *scan, faults=[planted]).code == -9
    assert names(folder) == {".room.partial"}
    left = folder / ".room.partial" / "capture"
    if moment.frames:
        found = open_capture(left)
        assert found.patterns == PATTERNS[: moment.frames]
        assert moment.word in " ".join(map(str, found.findings))
        assert bool(moment.word) == bool(found.findings)
    after = bench.run(folder, *scan)  # the next start
    assert after.code == 0
    kept = folder / "room-incomplete"
    assert ("A scan was killed" in after.said) == (kept.is_dir()) == bool(moment.frames)
    assert names(folder) == ({"room", "room-incomplete"} if moment.frames else {"room"})
    if moment.frames:
        assert f"{len(list((kept / 'capture/frames').glob('*.png')))} frames" in after.said
        assert names(kept) == {"capture", "scan.log"}
        assert ("none is missing, and scan replay" in after.said) == (moment.frames == len(PATTERNS))
        assert ("scan --resume" in after.said) == (moment.frames < len(PATTERNS))


@pytest.mark.parametrize("fault", ["Ctrl-C", "Ctrl-C again and again", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("moment", [BEFORE_IMAGE, BEFORE_LINE], ids=lambda moment: moment.name)
def test_interrupted_while_recording(bench: FaultBench, config: Path, fault: str, moment: Moment) -> None:
    folder = config.parent
    planted = {"at": moment.at, "call": moment.call, "do": fault}
    ended = bench.run(folder, "--config", config, "--out", folder / "room", faults=[planted])
    assert ended.code == 130
    assert ended.said.startswith("scan: interrupted\n")
    assert f"The {moment.frames} frames captured so far" in ended.said
    assert "Traceback" not in ended.said
    assert names(folder) == {"room-incomplete"}
    found = open_capture(folder / "room-incomplete" / "capture")
    assert (found.patterns, found.findings) == (PATTERNS[: moment.frames], ())


def test_interrupted_while_cleaning_up(bench: FaultBench, config: Path) -> None:
    folder = config.parent
    first = {"at": f"{RECORDER}:write_png", "call": 5, "do": "Ctrl-C"}
    again = {"at": f"{RESULT}:keep_recording", "do": "Ctrl-C again and again"}
    late = {"at": "scanner.commands.main:_reported", "do": "SIGTERM"}
    ended = bench.run(folder, "--config", config, "--out", folder / "room", faults=[first, again, late])
    assert ended.code == 130
    assert "The 4 frames captured so far" in ended.said
    assert names(folder) == {"room-incomplete"}


def test_interrupted_while_modules_are_loaded() -> None:
    program = (
        "import os, signal, sys\n"
        "class Strike:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'numpy.linalg': [os.kill(os.getpid(), signal.SIGINT) for _ in range(2)]\n"
        "sys.meta_path.insert(0, Strike())\n"
        "sys.argv = ['scan', '--config', 'configs/room-sim.yaml']\n"
        "from scanner.__main__ import run\n"
        "sys.exit(run())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "scan: interrupted\n")


@dataclass(frozen=True)
class Publishing:
    """`at`: the function before which the process is killed; `there`: the report at the destination then, if any;
    `settled`: the report after the next start.
    """

    name: str
    at: str
    there: str | None
    settled: str
    call: int = 1
    in_two_steps: bool = False


# Each image is renamed when it is whole; then the older result is, and then the new one.
BETWEEN = len(PATTERNS) + 2
NO_EXCHANGE = {f"{PUBLISHING}:exchange": False}
PUBLISHED = [
    Publishing("before it is whole", f"{RESULT}:sync_tree", "old", "old"),
    Publishing("before the exchange", f"{RESULT}:publish", "old", "new"),
    Publishing("after the exchange", f"{PUBLISHING}:_tidy", "new", "new"),
    Publishing("while the older one is removed", "shutil:rmtree", "new", "new"),
    Publishing("two steps, before the first", f"{RESULT}:publish", "old", "new", in_two_steps=True),
    Publishing("two steps, between them", "pathlib:Path.rename", None, "new", call=BETWEEN, in_two_steps=True),
    Publishing("two steps, after them", f"{PUBLISHING}:_tidy", "new", "new", in_two_steps=True),
]


@pytest.mark.parametrize("moment", PUBLISHED, ids=lambda moment: moment.name)
def test_killed_while_replacing_a_result(bench: FaultBench, config: Path, moment: Publishing) -> None:
    folder, report = config.parent, config.with_name("room") / "report.html"
    scan = ("--config", config, "--out", folder / "room")
    assert bench.run(folder, *scan, says="old").code == 0
    replace = NO_EXCHANGE if moment.in_two_steps else {}
    planted = {"at": moment.at, "call": moment.call, "do": "SIGKILL"}
    killed = bench.run(folder, *scan, "--overwrite", faults=[planted], replace=replace)
    assert killed.code == -9
    assert (report.read_text() if report.exists() else None) == moment.there
    # The next start without --overwrite settles it, and is refused, for something is there.
    after = bench.run(folder, *scan)
    assert after.code == 2
    assert "already exists" in after.said
    assert report.read_text() == moment.settled
    kept = {"room-incomplete"} if moment.settled == "old" else set()
    assert names(folder) == {"room"} | kept
    assert names(folder / "room") == {"report.html", "scan.log", "capture"}


def test_interrupted_while_replacing_a_result(bench: FaultBench, config: Path) -> None:
    folder, scan = config.parent, ("--config", config, "--out", config.with_name("room"))
    assert bench.run(folder, *scan, says="old").code == 0
    planted = {"at": f"{PUBLISHING}:_tidy", "do": "Ctrl-C again and again"}
    ended = bench.run(folder, *scan, "--overwrite", faults=[planted])
    assert ended.code == 130
    assert f"The result is in {folder / 'room'}" in ended.said
    assert names(folder) == {"room"}
    assert (folder / "room" / "report.html").read_text() == "new"


def test_a_second_scan_into_the_same_folder_is_refused_at_once(bench: FaultBench, config: Path) -> None:
    folder, out = config.parent, config.with_name("room")
    scan = ["--config", str(config), "--out", str(out)]
    planted = {"at": f"{RECORDER}:write_png", "call": 3, "do": "another scan", "where": str(folder / "second.txt")}
    ended = bench.run(folder, *scan, faults=[planted | {"arguments": scan}])
    assert (ended.code, (folder / "second.txt").read_text()) == (0, "2")
    assert "another scan is writing there now (process " in ended.said
    assert len(open_capture(out / "capture").patterns) == len(PATTERNS)


def test_a_reused_process_number_is_no_obstacle(bench: FaultBench, config: Path) -> None:
    left = config.with_name(".room.partial")
    left.mkdir()
    for process in range(2):  # whatever it says, nobody holds it
        (left / ".scan-unfinished").write_text(f"live      {process:<10}\n")
        assert bench.run(config.parent, "--config", config, "--out", config.with_name("room"), "--overwrite").code == 0
        left.mkdir(exist_ok=True)
    left.rmdir()


@dataclass(frozen=True)
class Disk:
    """`options` of a separate file system, which another program fills at a call of the function `filled`, at this
    number of `frames`.
    """

    name: str
    options: str
    words: tuple[str, ...]
    filled: tuple[str, int] | None = None
    frames: int = 0
    read_only: bool = False


FULL = ("room: cannot be written: No space left", "frames captured so far", "scan replay")
DISKS = [
    Disk("too small", "size=3m", ("a capture of 28 frames of 48 × 32 px", "needs up to 4 MB", "3 MB are free")),
    Disk("too few inodes", "size=20m,nr_inodes=20", ("needs 28 files", "takes only", "inodes")),
    Disk("read-only", "size=20m", ("cannot be made: Read-only file system",), read_only=True),
    Disk("filled while frames come", "size=20m", FULL, (f"{RECORDER}:write_png", TAKEN), TAKEN - 1),
    Disk("filled before the result", "size=20m", FULL, ("scanner.jobs:reconstruct", 1), len(PATTERNS)),
]


@pytest.mark.parametrize("disk", DISKS, ids=lambda disk: disk.name)
def test_a_full_disk_during_a_scan(bench: FaultBench, config: Path, disk: Disk) -> None:
    where = config.with_name("disk")
    where.mkdir()
    mount = {"where": where, "options": disk.options, "read_only": disk.read_only}
    planted = [{"at": at, "call": call, "do": "full disk", "where": where} for at, call in filter(None, [disk.filled])]
    ended = bench.run(config.parent, "--config", config, "--out", where / "room", mount=mount, faults=planted)
    assert ended.code == 3
    assert "Traceback" not in ended.said
    for word in (str(where), *disk.words):
        assert word in ended.said
    images = [name for name in ended.files if name.endswith(".png")]
    assert len(images) == disk.frames
    others = {"filling", "room-incomplete/scan.log", "room-incomplete/capture/capture.yaml"} if disk.filled else set()
    assert set(ended.files) == {*images, *others}  # nothing that looks like a result


MADE_OF_A_RESULT = {
    "the cloud": ("export", "{result}", "--to", "ply", "--out", "{disk}/cloud.ply"),
    "three files that belong together": ("export", "{result}", "--to", "colmap", "--out", "{disk}/model"),
    "a page and a document": ("compare", "{result}", "{result}", "--out", "{disk}/compared"),
    "a board to print": ("board", "--print", "charuco:A4", "--out", "{disk}/board.pdf"),
    "a picture and a document": ("measure", "{result}", "--out", "{disk}/measured"),
}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("made") / "room", keep=lambda px: np.all(px % 8 < 1, axis=1)).folder


@pytest.mark.parametrize("read_only", [False, True], ids=["full", "read-only"])
@pytest.mark.parametrize("made", MADE_OF_A_RESULT)
def test_a_full_disk_while_exporting(
    bench: FaultBench, result: Path, tmp_path: Path, made: str, read_only: bool
) -> None:
    where = tmp_path / "disk"
    where.mkdir()
    mount = {"where": where, "options": "size=12k", "read_only": read_only}
    command = [word.format(result=result, disk=where) for word in MADE_OF_A_RESULT[made]]
    ended = bench.run(tmp_path, *command, mount=mount)
    assert ended.code == 3
    assert str(where) in ended.said
    assert "partial" not in ended.said
    assert "choose another --out" in ended.said
    assert "Traceback" not in ended.said
    assert ended.files == {}


@pytest.mark.parametrize("older", [False, True], ids=["new", "--overwrite"])
def test_killed_between_two_of_several_files(bench: FaultBench, result: Path, tmp_path: Path, older: bool) -> None:
    """The next program completes them, even if it then refuses because they exist."""
    model, export = tmp_path / "model", ("export", result, "--to", "colmap", "--out", tmp_path / "model")
    if older:
        assert bench.run(tmp_path, *export, "--points", 100).code == 0
    assert bench.run(tmp_path, *export[:-1], tmp_path / "whole").code == 0
    planted = {"at": "pathlib:Path.replace", "call": 2, "do": "SIGKILL"}
    assert bench.run(tmp_path, *export, "--overwrite", faults=[planted]).code == -9
    after = bench.run(tmp_path, *export)
    assert after.code == 2
    assert "A program was killed after its files were complete" in after.said
    assert "already exists" in after.said
    assert {path.name: path.read_bytes() for path in model.iterdir()} == {
        path.name: path.read_bytes() for path in (tmp_path / "whole").iterdir()
    }


def test_ctrl_c_between_two_of_several_files_acts_after_them(bench: FaultBench, result: Path, tmp_path: Path) -> None:
    planted = {"at": "pathlib:Path.replace", "call": 2, "do": "Ctrl-C again and again"}
    export = ("export", result, "--to", "colmap", "--out", tmp_path / "model")
    assert bench.run(tmp_path, *export, faults=[planted]).code == 130
    assert names(tmp_path / "model") == {"cameras.txt", "images.txt", "points3D.txt"}


def test_killed_while_a_file_is_written(bench: FaultBench, result: Path, tmp_path: Path) -> None:
    planted = {"at": "scanner.io.atomic_file:sync", "do": "SIGKILL"}
    export = ("export", result, "--to", "ply", "--out", tmp_path / "cloud.ply")
    assert bench.run(tmp_path, *export, faults=[planted]).code == -9
    assert not (tmp_path / "cloud.ply").exists()
    after = bench.run(tmp_path, *export)
    assert after.code == 0
    assert "files of a killed program were removed: cloud.ply" in after.said
    assert names(tmp_path) == {"cloud.ply"}


@pytest.mark.parametrize("largest_file", [1200, 3500])
def test_a_file_size_limit(bench: FaultBench, config: Path, largest_file: int) -> None:
    """The log, the listing's header or one of its lines is the first that does not fit."""
    folder = config.parent
    ended = bench.run(folder, "--config", config, "--out", folder / "room", largest_file=largest_file)
    assert ended.code == 3
    assert "File too large" in ended.said
    assert "ulimit -f" in ended.said
    assert "Traceback" not in ended.said
    assert "Logging error" not in ended.said
    assert not (folder / "room").exists()
    if kept := names(folder):
        assert kept == {"room-incomplete"}
        assert 0 < len(open_capture(folder / "room-incomplete" / "capture").patterns) < len(PATTERNS)


def pictures(capture: Path) -> dict[str, bytes]:
    """The last frame of each pattern, as it was taken."""
    recording = open_capture(capture)
    frames = zip(recording.patterns, recording.stream().frames, strict=True)
    return {str(pattern): frame.image.tobytes() for pattern, (_, frame) in frames}


@pytest.mark.parametrize("moment", [BEFORE_IMAGE, BEFORE_LINE], ids=lambda moment: moment.name)
@pytest.mark.parametrize(
    ("fault", "code"), [("SIGKILL", -9), ("SIGTERM", 130), ("SIGHUP", 130), ("Ctrl-C", 130), ("no room", 3)]
)
def test_a_capture_is_resumed_however_it_ended(
    bench: FaultBench, config: Path, fault: str, code: int, moment: Moment
) -> None:
    folder = config.parent
    assert bench.run(folder, "--config", config, "--out", folder / "whole").code == 0
    planted = {"at": moment.at, "call": moment.call, "do": fault}
    assert bench.run(folder, "--config", config, "--out", folder / "room", faults=[planted]).code == code
    resumed = bench.run(folder, "--resume", folder / "room-incomplete")
    assert resumed.code == 0, resumed.said
    assert pictures(folder / "room" / "capture") == pictures(folder / "whole" / "capture")
    assert len(open_capture(folder / "room" / "capture").patterns) >= len(PATTERNS)


@pytest.mark.parametrize("count", range(1, len(PATTERNS), 5))
def test_an_interrupted_capture_is_resumed(bench: FaultBench, config: Path, count: int) -> None:
    folder = config.parent
    planted = {"at": f"{RECORDER}:write_png", "call": count + 1, "do": "SIGTERM"}
    assert bench.run(folder, "--config", config, "--out", folder / "room", faults=[planted]).code == 130
    kept = folder / "room-incomplete"
    if count < WITH_Y:
        with pytest.raises(InputError, match=r"Missing or left out: bits .* no pattern varies along"):
            decoded(kept / "capture")
    else:
        assert decoded(kept / "capture") > 0
    resumed = bench.run(folder, "--resume", kept)
    assert (resumed.code, resumed.said) == (0, "")
    whole = open_capture(folder / "room" / "capture")
    assert whole.patterns[:count] == PATTERNS[:count]
    assert tuple(dict.fromkeys(whole.patterns)) == PATTERNS
    assert whole.planned == whole.patterns
    assert names(folder) == {"room", "room-incomplete"}
    again = bench.run(folder, "--resume", folder / "room")
    assert again.code == 2
    assert "nothing is missing" in again.said
