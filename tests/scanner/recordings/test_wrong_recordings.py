"""Files that are no recording of the video are refused in one sentence, with exit code 2."""

import sys
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from calib.geometry import Size
from scanner.errors import InputError
from scanner.patterns import PRESETS, write_sequence
from scanner.recordings.programme import WHITE, programme_of
from scanner.recordings.video_file import av as library
from tests.support.command_line import run
from tests.support.room import PROJECTOR, FilmedRoom

pytestmark = pytest.mark.xdist_group("recordings")


def text(path: Path, recording: Path) -> None:
    path.write_text("no film\n")


def picture(path: Path, recording: Path) -> None:
    assert cv2.imwrite(str(path.with_suffix(".png")), np.zeros((48, 64), np.uint8))
    path.with_suffix(".png").rename(path)


def still(path: Path, recording: Path) -> None:
    of_frames(path, lambda number: 90, count=1)


def sound(path: Path, recording: Path) -> None:
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("aac", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def cut_off(path: Path, recording: Path) -> None:
    whole = recording.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def of_frames(path: Path, level: Callable[[int], float], count: int = 300) -> None:
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(count):
            image = np.full((48, 64), np.uint8(level(number)))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "gray").reformat(format="yuv420p")))
        container.mux(stream.encode(None))


def nothing_happens(path: Path, recording: Path) -> None:
    of_frames(path, lambda number: 90)


def slow_motion(path: Path, recording: Path) -> None:
    shown = programme_of(PRESETS["quick"].patterns(PROJECTOR), Size(*PROJECTOR), 0.1, 1)
    frames = 4 * 30 * shown.hold_s
    mark = [200.0 if slot == WHITE else 20.0 for slot in shown.mark]
    of_frames(path, lambda number: mark[int(number / frames)] if number < len(mark) * frames else 20.0)


def another_film(path: Path, recording: Path) -> None:
    levels = np.random.default_rng(0).uniform(20, 230, 300)
    of_frames(path, lambda number: float(levels[number // 8]))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (text, "cannot be read"),
        (picture, "of another kind"),
        (still, "is it a still?"),
        (sound, "a file without pictures"),
        (cut_off, "copy the file again, whole"),
        (nothing_happens, "nothing in it changes"),
        (slow_motion, "4 times slower"),
        (another_film, "no start mark"),
    ],
)
def test_a_file_that_is_no_recording_is_refused(
    filmed: FilmedRoom,
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    make: Callable[[Path, Path], None],
    told: str,
) -> None:
    path = tmp_path / "file.mp4"
    make(path, recording)
    assert run("import", path, "--sequence", filmed.sequence, "--out", tmp_path / "capture") == 2
    message = capsys.readouterr().err
    assert told in message
    assert message.count("\n") == 1
    assert not (tmp_path / "capture").exists()


def test_the_sequence_of_another_video_is_refused(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = programme_of(PRESETS["standard"].patterns(PROJECTOR), Size(*PROJECTOR), 0.1, 1)
    write_sequence(tmp_path, other.patterns, PROJECTOR, video=other.as_dict("video.mp4"))
    assert run("import", recording, "--sequence", tmp_path / "sequence.yaml", "--out", tmp_path / "capture") == 2
    assert "is not that of this sequence" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--from", "opencv"), "--from: only for a folder"),
        (("--out", "x"), "needs --sequence"),
        (("--sequence", "configs/room-sim.yaml", "--out", "x"), "sequence.yaml of a video"),
    ],
)
def test_wrong_options_are_reported(
    recording: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], told: str
) -> None:
    assert run("import", recording, *arguments) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--hold", "0.2s"), "give --video"),
        (("--video", "sequence.avi"), "expected a file name"),
        (("--video", "a/b.mp4"), "expected a file name"),
        (("--video", "a.mp4", "--hold", "soon"), "expected seconds"),
        (("--video", "a.mp4", "--hold", "nan"), "expected 0.05 to 10 seconds"),
        (("--video", "a.mp4", "--loops", "0"), "expected 1 to 20 loops"),
    ],
)
def test_wrong_videos_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], told: str
) -> None:
    assert run("patterns", "--config", "configs/room-sim.yaml", "--out", tmp_path / "out", *arguments) == 2
    assert told in capsys.readouterr().err


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match="video needs av, which is not installed; type: "):
        library()
