import logging
import warnings
from multiprocessing import get_context
from pathlib import Path

import pytest

from calib.refusal import RefusalError
from hw.errors import DeviceError
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.results.names import default_out
from scanner.results.result_folder import OutputFolder, new_result
from tests.support.findings import FOR_TESTS

CONFIG = load_config(None)


def make_result(out: Path, content: str = "new", *, overwrite: bool = False) -> None:
    with new_result(out, CONFIG, overwrite=overwrite) as folder:
        (folder / "report.html").write_text(content)


def fail(out: Path, error: BaseException, *, frames: int = 2, keep_capture: bool = False) -> None:
    """Begin a result, capture something, and raise an error."""
    with new_result(out, CONFIG, overwrite=False, keep_capture=keep_capture) as folder:
        capture_something(folder, frames)
        (folder / "report.html").write_text("why")
        raise error


def capture_something(folder: Path, count: int) -> None:
    frames = folder / "capture" / "frames"
    frames.mkdir(parents=True)
    for index in range(count):
        (frames / f"{index:03d}.png").touch()


def test_a_result_appears_only_when_complete(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "room"
    with new_result(out, CONFIG, overwrite=False) as folder:
        (folder / "report.html").write_text("half")
        assert not out.exists()
        assert folder.parent == out.parent
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "scan.log"]
    assert [path.name for path in out.parent.iterdir()] == ["room"]


@pytest.mark.parametrize("error", [InputError("wrong"), KeyboardInterrupt(), RuntimeError("a bug")])
def test_an_error_leaves_nothing_behind(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)):
        fail(tmp_path / "deep" / "room", error)
    assert list(tmp_path.iterdir()) == []


def test_a_refusal_is_a_result(tmp_path: Path) -> None:
    out = tmp_path / "room"
    with pytest.raises(RefusalError) as caught:
        fail(out, RefusalError(FOR_TESTS, "No corner.", "Look for one."))
    assert (out / "report.html").read_text() == "why"
    assert "RefusalError" in (out / "scan.log").read_text()
    assert str(out) in caught.value.__notes__[0]


@pytest.mark.parametrize("error", [DeviceError("the lamp is off"), KeyboardInterrupt(), InputError("wrong")])
def test_a_live_capture_is_never_lost(tmp_path: Path, error: BaseException) -> None:
    out = tmp_path / "room"
    for kept in ("room-incomplete", "room-incomplete-2"):
        with pytest.raises(type(error)) as caught:
            fail(out, error, keep_capture=True)
        assert len(list((tmp_path / kept / "capture" / "frames").iterdir())) == 2
        assert f"2 frames captured so far are in {tmp_path / kept / 'capture'}" in caught.value.__notes__[-1]
        assert "Traceback" in (tmp_path / kept / "scan.log").read_text()
    assert not out.exists()


def test_a_live_capture_without_a_frame_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(DeviceError):
        fail(tmp_path / "room", DeviceError("no camera"), frames=0, keep_capture=True)
    assert list(tmp_path.iterdir()) == []


def test_existing_folders_are_not_touched(tmp_path: Path) -> None:
    out = tmp_path / "room"
    make_result(out, "old")
    with pytest.raises(InputError, match=r"already exists.*--overwrite"):
        make_result(out)
    assert (out / "report.html").read_text() == "old"


def test_a_result_can_be_replaced(tmp_path: Path) -> None:
    out = tmp_path / "room"
    make_result(out, "old")
    make_result(out, "new", overwrite=True)
    assert (out / "report.html").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["room"]


def test_a_result_survives_a_failed_replacement(tmp_path: Path) -> None:
    out = tmp_path / "room"
    make_result(out, "old")
    with pytest.raises(RuntimeError), new_result(out, CONFIG, overwrite=True):
        raise RuntimeError("a bug")
    assert (out / "report.html").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["room"]


def test_an_empty_folder_counts_as_none(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    make_result(tmp_path / "room")
    assert (tmp_path / "room" / "report.html").read_text() == "new"


def test_only_results_are_overwritten(tmp_path: Path) -> None:
    file, folder, result, link = (tmp_path / name for name in ("file", "folder", "result", "link"))
    file.write_text("a thesis")
    folder.mkdir()
    (folder / "thesis.tex").write_text("a thesis")
    make_result(result)
    (result / "thesis.tex").write_text("a thesis")
    link.symlink_to(folder)
    for out, words in (
        (file, "no result of an earlier scan"),
        (folder, "no result of an earlier scan"),
        (link, "no result of an earlier scan"),
        (result, "holds files of others: thesis.tex"),
    ):
        with pytest.raises(InputError, match=words):
            make_result(out, overwrite=True)
    assert (result / "thesis.tex").exists()
    assert (folder / "thesis.tex").exists()


def test_a_folder_created_meanwhile_is_kept_beside_the_result(tmp_path: Path) -> None:
    out = tmp_path / "room"
    output = OutputFolder(out)

    def two_at_once() -> None:
        with output:
            (output.folder / "report.html").write_text("mine")
            out.write_text("theirs")

    with pytest.raises(InputError, match="already exists") as caught:
        two_at_once()
    assert out.read_text() == "theirs"
    assert f"the result is in {tmp_path / 'room-2'}" in str(caught.value)
    assert (tmp_path / "room-2" / "report.html").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room", "room-2"]


def test_an_unwritable_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be made"):
        make_result(tmp_path / "file" / "room")


def test_default_names_count_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for expected in ("room", "room-2", "room-3"):
        out = default_out("room", overwrite=False)
        assert out == Path("scans") / expected
        make_result(out)
    assert default_out("room", overwrite=True) == Path("scans/room")


@pytest.mark.filterwarnings("default::RuntimeWarning")
def test_the_log_holds_messages_and_warnings(tmp_path: Path) -> None:
    with new_result(tmp_path / "room", load_config(None, ["rig.seed=5"]), overwrite=False):
        logging.getLogger("scanner.anything").info("a step")
        warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)
    logging.getLogger("scanner.anything").info("too late")
    text = (tmp_path / "room" / "scan.log").read_text()
    assert '"seed":5' in text
    assert "a step" in text
    assert "divide by zero" in text
    assert "too late" not in text


def _make(place: tuple[str, int]) -> tuple[str, list[str]]:
    folder, number = place
    with OutputFolder(Path(folder) / str(number)) as output:
        (output.folder / "report.html").write_text("whole")
    return (Path(folder) / str(number) / "report.html").read_text(), output.settled


def test_concurrent_results_do_not_interfere(tmp_path: Path) -> None:
    """Each looks for leftovers of killed programs, and meets what others have just begun."""
    with get_context("fork").Pool(4) as pool:
        made = pool.map(_make, [(str(tmp_path / "scans"), number) for number in range(500)], chunksize=1)
    assert made == [("whole", [])] * 500
    assert len(list((tmp_path / "scans").iterdir())) == 500


@pytest.mark.parametrize("out", ["", ".", "/", ".."])
def test_a_folder_without_a_name_is_refused(out: str) -> None:
    with pytest.raises(InputError, match="expected the name of a folder to make"):
        OutputFolder(Path(out))
