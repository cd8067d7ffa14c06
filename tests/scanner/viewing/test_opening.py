"""The address of the page, and its verdict."""

import re
import socket
import sys
from pathlib import Path

import pytest

from hw.optional_parts import CONSOLE
from scanner.commands import main
from scanner.errors import InputError
from scanner.results import Verdict
from scanner.viewing.opening import address, free_port, is_local, require_viser, warning
from scanner.viewing.texts import escaped, verdict_text


def test_without_viser_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=re.escape(CONSOLE.install_command())):
        require_viser()
    (config := tmp_path / "room.yaml").touch()
    for command in (["view", str(tmp_path)], ["console", "--config", str(config)]):
        assert main(command) == 2
        assert CONSOLE.install_command() in capsys.readouterr().err


def test_a_port_in_use_is_reported() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match="another program uses it"):
            free_port("127.0.0.1", port)
    assert free_port("127.0.0.1", port) == port


def test_without_a_given_port_the_next_free_one_is_used() -> None:
    first = free_port("127.0.0.1", None)
    with socket.socket() as other:
        other.setsockopt(
            socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
        )  # as servers do, or a page just closed is in the way
        other.bind(("127.0.0.1", first))
        other.listen()
        assert free_port("127.0.0.1", None) > first


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_impossible_ports_are_refused(port: int) -> None:
    with pytest.raises(InputError, match="1 to 65535"):
        free_port("127.0.0.1", port)


def test_foreign_addresses_are_refused() -> None:
    with pytest.raises(InputError, match="cannot be served at"):
        free_port("192.0.2.1", 8080)  # RFC 5737: nobody's


def test_only_remote_access_gives_a_warning() -> None:
    for host in ("127.0.0.1", "::1", "localhost", "127.8.8.8"):
        assert is_local(host)
        assert warning(host) == ""
    for host in ("0.0.0.0", "192.168.1.5", "rig.local", "::"):
        assert not is_local(host)
        assert "token" in warning(host)


def test_the_address_to_open() -> None:
    assert address("127.0.0.1", 80) == "http://127.0.0.1:80"
    assert address("::1", 81) == "http://[::1]:81"
    assert address("rig.local", 82) == "http://rig.local:82"
    assert address("0.0.0.0", 83) == f"http://{socket.gethostname()}:83"


def test_the_verdict_is_shown_in_words() -> None:
    text = verdict_text(Verdict("fair", "Calibrated <b>", ("Known to ± 3 %", "Second"), "Capture it again."))
    assert text.startswith("**◐ Calibrated \\<b\\>**")
    assert "- Known to ± 3 %" in text.replace("\N{NO-BREAK SPACE}", " ")
    assert text.endswith("Capture it again.")
    assert "does not state" in verdict_text(None)


def test_text_from_files_is_escaped() -> None:
    assert escaped("<img src=x> [a](b) *c*") == r"\<img src=x\> \[a\](b) \*c\*"
