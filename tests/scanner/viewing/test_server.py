"""Access control of the page, over real sockets, with requests as a foreign site would make a browser send them."""

import http.client
import os
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from email.message import Message
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser", reason="the page needs the extra 'console'")

import viser
import websockets.sync.client
import websockets.sync.connection
import websockets.typing
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosedError, InvalidStatus

from scanner.viewing.server import OriginCheck, Serving, serving


@pytest.fixture(scope="module")
def served() -> Iterator[Serving]:
    with serving("a page", "127.0.0.1", None) as served:
        yield served


@pytest.fixture(scope="module")
def where(served: Serving) -> str:
    """The printed address of a page."""
    return served.address


@dataclass(frozen=True)
class Answer:
    status: int
    headers: Message
    text: str


def ask(where: str, path: str = "/", **headers: str) -> Answer:
    with closing(http.client.HTTPConnection(urlsplit(where).netloc, timeout=20)) as connection:
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        return Answer(response.status, response.headers, response.read().decode())


def cookie(where: str) -> str:
    """The cookie that a browser gets from the printed address."""
    parts = urlsplit(where)
    response = ask(where, f"{parts.path}?{parts.query}")
    assert response.status == 200
    assert "location.replace(" in response.text
    told = response.headers["Set-Cookie"]
    assert "HttpOnly" in told
    assert "SameSite=Strict" in told
    return told.split(";")[0]


def test_the_printed_address_opens_the_page(where: str) -> None:
    response = ask(where, Cookie=cookie(where))
    assert response.status == 200
    assert "<html" in response.text


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=guessed", "/index.html"])
def test_without_the_token_there_is_no_page(where: str, path: str) -> None:
    response = ask(where, path)
    assert response.status == 403
    assert "token" in response.text


def test_a_foreign_host_name_is_refused(where: str) -> None:
    assert ask(where, Host="evil.example:8080", Cookie=cookie(where)).status == 403


@pytest.mark.parametrize("path", ["/" + "a" * 5000, "/results/1-x/" + "a" * 5000, "/%00", "/..%2f..%2fetc%2fpasswd"])
def test_unknown_paths_are_answered(where: str, path: str) -> None:
    answer = ask(where, path, Cookie=cookie(where))
    assert answer.status in (400, 404)
    assert "/" not in answer.text  # nor is it said what there is


def test_a_duplicate_host_header_is_refused(where: str, capfd: pytest.CaptureFixture[str]) -> None:
    with closing(http.client.HTTPConnection(urlsplit(where).netloc, timeout=20)) as connection:
        connection.putrequest("GET", "/")
        connection.putheader("Host", "evil.example")
        connection.endheaders()
        assert connection.getresponse().status == 400
    assert "Traceback" not in capfd.readouterr().err


def hear_out(page: websockets.sync.connection.Connection) -> None:
    while True:
        page.recv(timeout=20)


@pytest.mark.parametrize("message", [b"\xc1", b"\x91" * 100_000, "text"])
def test_a_malformed_message_closes_only_its_connection(
    where: str, message: str | bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    place, headers = f"ws://{urlsplit(where).netloc}/", {"Cookie": cookie(where)}
    spoken = [websockets.typing.Subprotocol(f"viser-v{viser.__version__}")]
    with websockets.sync.client.connect(place, additional_headers=headers, subprotocols=spoken) as page:
        page.send(message)
        with pytest.raises(ConnectionClosedError):
            hear_out(page)
    assert ask(where, Cookie=cookie(where)).status == 200
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("own", [True, False])
def test_a_websocket_has_to_come_from_the_page_itself(where: str, own: bool) -> None:
    netloc = urlsplit(where).netloc
    origin = f"http://{netloc}" if own else "https://evil.example"
    headers = {"Cookie": cookie(where)}
    if own:
        with websockets.sync.client.connect(f"ws://{netloc}/", origin=origin, additional_headers=headers):  # type: ignore[arg-type]
            pass
    else:
        with (
            pytest.raises(InvalidStatus) as caught,
            websockets.sync.client.connect(f"ws://{netloc}/", origin=origin, additional_headers=headers),  # type: ignore[arg-type]
        ):
            pass
        assert caught.value.response.status_code == 403


@pytest.fixture(scope="module")
def report(served: Serving, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of a report in a folder with other files."""
    folder = tmp_path_factory.mktemp("results") / "a room & more"
    (folder / "captures/1").mkdir(parents=True)
    (folder / "report.html").write_text("<script>alert(1)</script>")
    (folder / "captures/1/calibration.yaml").write_text("camera: {}")
    (folder.parent / "secret.html").write_text("secret")
    (folder / "out.html").symlink_to(folder.parent / "secret.html")
    (folder / "room.glb").touch()
    os.truncate(folder / "room.glb", 50_000_000_000)
    return served.served_files.link(folder / "report.html")


def test_a_report_is_shown_without_foreign_scripts_and_its_files_are_downloaded(where: str, report: str) -> None:
    shown = ask(where, report, Cookie=cookie(where))
    assert (shown.status, shown.text) == (200, "<script>alert(1)</script>")
    policy = shown.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'sha256-" in policy
    assert "unsafe-inline" not in policy.partition("script-src")[2]
    file = ask(where, report.replace("report.html", "captures/1/calibration.yaml"), Cookie=cookie(where))
    assert (file.status, file.text) == (200, "camera: {}")
    assert file.headers["Content-Disposition"].startswith("attachment")
    assert file.headers["X-Content-Type-Options"] == "nosniff"


def test_files_require_the_token(where: str, report: str) -> None:
    assert ask(where, report).status == 403
    assert ask(where, report, Cookie=cookie(where), Host="evil.example").status == 403


@pytest.mark.parametrize(
    "name",
    [
        "../secret.html",
        "..%2Fsecret.html",
        "out.html",
        "room.glb",
        "captures",
        "",
        "%00",
        "captures//1/calibration.yaml",
        "nothing",
    ],
)
def test_only_files_of_offered_folders_are_served(where: str, report: str, name: str) -> None:
    for path in (report.replace("report.html", name), f"/results/2-results/{name}"):
        answer = ask(where, path, Cookie=cookie(where))
        assert answer.status == 404
        assert "secret" not in answer.text


@given(st.text(max_size=40), st.text(max_size=40), st.text(max_size=40))
def test_random_requests_neither_crash_the_server_nor_pass(asked: str, query: str, cookies: str) -> None:
    origin_check = OriginCheck("127.0.0.1")
    refused = origin_check.answer(f"/?token={query}", {"Host": asked, "Cookie": cookies})
    assert refused is not None
    assert refused.status_code == 403
