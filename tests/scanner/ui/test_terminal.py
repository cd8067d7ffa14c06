"""Progress where stderr is no terminal."""

from threading import Event

import pytest

from scanner.ui import terminal
from scanner.ui.terminal import Terminal

SOON_S = 0.01


class _Watched(Terminal):
    """Sets `told` with the first line."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self.told = Event()

    def note(self, text: str) -> None:
        super().note(text)
        self.told.set()


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "LINE_EVERY_S", SOON_S)


def test_a_long_step_is_told_in_lines(capsys: pytest.CaptureFixture[str]) -> None:
    watched = _Watched()
    with watched.step("Calibrating"):
        assert watched.told.wait(60)
    assert "Calibrating: 0 s so far" in capsys.readouterr().err


def test_lines_count_what_went_by(capsys: pytest.CaptureFixture[str]) -> None:
    watched = _Watched()
    for item in watched.track("abc", 3, "Reading"):
        if item == "c":
            watched.told.clear()
            assert watched.told.wait(60)
    assert "Reading, 2 of 3: 0 s so far" in capsys.readouterr().err


def test_the_quiet_are_told_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    watched = _Watched(quiet=True)
    with watched.step("Calibrating"):
        assert not watched.told.wait(5 * SOON_S)
    assert capsys.readouterr().err == ""
