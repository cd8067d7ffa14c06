"""Results get other names, notes, and go into a bin and out of it; nothing outside their folder is touched."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.console.results import (
    BIN,
    NOTE_FILE,
    bin_result,
    card_of,
    changes_s,
    earlier_results,
    last_binned,
    note_of,
    rename_result,
    restore_result,
    write_note,
)
from scanner.console.texts import card_html
from scanner.errors import InputError
from tests.support.hostile import TEXT


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    for name in ("hall", "room"):
        make_result(tmp_path / "scans" / name)
    return tmp_path / "scans"


def make_result(folder: Path) -> None:
    folder.mkdir(parents=True)
    for file in ("scan.log", "matches.npz"):
        (folder / file).write_text(folder.name)


def everything(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_result_is_renamed_within_its_folder(scans: Path) -> None:
    place = rename_result(scans / "room", "Kitchen, north wall")
    assert place == scans / "Kitchen-north-wall"
    assert (place / "scan.log").read_text() == "room"
    assert not (scans / "room").exists()
    assert rename_result(place, "Kitchen-north-wall") == place  # as it was


OUTSIDE = ["../out", "/etc/passwd", "..", ".", "a/../../b", "C:\\x", ".bin", "x\0y", TEXT, "中" * 90]


@given(typed=st.text() | st.sampled_from(OUTSIDE))
def test_no_name_leaves_the_folder_or_hides_in_it(typed: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("shelf")
    scans = outside / "scans"
    make_result(scans / "room")
    try:
        place = rename_result(scans / "room", typed)
    except InputError:
        place = scans / "room"
    assert place.parent == scans
    assert not place.name.startswith(".")
    assert place.resolve() == place
    assert (place / "scan.log").is_file()
    assert [path.name for path in outside.iterdir()] == ["scans"]


@pytest.mark.parametrize("typed", ["", "  ", "../..", "hall", "hall/", "…"])
def test_a_name_that_is_none_or_taken_is_refused(scans: Path, typed: str) -> None:
    before = everything(scans)
    with pytest.raises(InputError, match=r"needs a letter or a digit|called hall already"):
        rename_result(scans / "room", typed)
    assert everything(scans) == before


def test_an_empty_folder_and_a_broken_link_are_names_that_are_taken(scans: Path) -> None:
    (scans / "empty").mkdir()
    (scans / "link").symlink_to(scans / "nowhere")
    for name in ("empty", "link"):
        with pytest.raises(InputError, match=f"called {name} already"):
            rename_result(scans / "room", name)


def test_a_note_is_kept_changed_and_removed(scans: Path) -> None:
    room = scans / "room"
    assert (note_of(room), changes_s(room)[1]) == ("", 0.0)
    for text in ("the lamp was on\nand the door open", TEXT):
        write_note(room, text)
        assert note_of(room) == text
        assert sorted(path.name for path in room.iterdir()) == ["matches.npz", NOTE_FILE, "scan.log"]
    assert changes_s(room)[1] > 0
    write_note(room, " \n")
    assert not (room / NOTE_FILE).exists()


def test_a_note_is_shown_as_text(scans: Path) -> None:
    write_note(scans / "room", TEXT)
    html = card_html(card_of(scans / "room", *changes_s(scans / "room")))
    assert "<script" not in html
    assert "<img src=x" not in html
    assert "\x1b" not in html
    assert "&lt;script&gt;" in html


def test_notes_that_are_too_long_or_no_text(scans: Path) -> None:
    write_note(scans / "room", "before")
    with pytest.raises(InputError, match="up to 4000 characters, this one 4001"):
        write_note(scans / "room", "x" * 4001)
    assert note_of(scans / "room") == "before"
    (scans / "room" / NOTE_FILE).write_bytes(b"\xff\xfe\x00")
    assert note_of(scans / "room") == ""
    write_note(scans / "room", "half a pair: \ud800")
    assert note_of(scans / "room") == "half a pair: ?"


def test_the_bin_gives_everything_back_in_the_order_it_came(scans: Path) -> None:
    before = everything(scans)
    assert last_binned(scans) is None
    for name in ("room", "hall"):
        binned = bin_result(scans / name)
        assert binned.is_relative_to(scans / BIN)
        assert last_binned(scans) == binned
    assert earlier_results(scans) == ()
    for name in ("hall", "room"):
        binned = last_binned(scans) or Path()
        assert restore_result(binned) == scans / name
    assert everything(scans) == before
    assert last_binned(scans) is None
    assert not (scans / BIN).exists()


def test_the_same_name_is_deleted_twice_and_comes_back_beside_a_new_one(scans: Path) -> None:
    bin_result(scans / "room")
    make_result(scans / "room")
    (scans / "room" / "scan.log").write_text("second")
    bin_result(scans / "room")
    make_result(scans / "room")
    binned = [last_binned(scans) or Path()]
    assert restore_result(binned[0]) == scans / "room-2"
    assert (scans / "room-2" / "scan.log").read_text() == "second"
    assert restore_result(last_binned(scans) or Path()) == scans / "room-3"


def test_what_is_not_there_any_more_is_said_by_name(scans: Path) -> None:
    acts: list[Callable[[Path], object]] = [bin_result, restore_result]
    acts += [lambda gone: rename_result(gone, "new"), lambda gone: write_note(gone, "x")]
    for act in acts:
        with pytest.raises(InputError, match=r"gone.*: cannot be .*; nothing was changed"):
            act(scans / BIN / "1" / "gone")
    assert sorted(path.name for path in scans.iterdir()) in (["hall", "room"], [BIN, "hall", "room"])
