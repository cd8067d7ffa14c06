"""The page's server: viser, as quiet and as private as it can be, and readable.

Access control of the page: only who has its address, and only from the page itself.

A browser lets any website open a websocket to this computer. So three things are checked. The `Origin` of a request
must be the page's own. Its `Host` must not be a name that a foreign DNS server could resolve to this computer (DNS
rebinding). And it must carry a token from the printed address: in the query of the first request, which is answered
with a cookie, and in that cookie from then on.

Files of results at addresses of the page's server, so that a report opens with its links and pictures.

Only files in offered folders are served, for any address. A result may be of unknown origin: its pages run only the
report's own viewer script, and load nothing; everything else is downloaded, never shown.
"""

import http
import logging
import secrets
import socket
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from http.cookies import CookieError, SimpleCookie
from io import StringIO
from ipaddress import ip_address
from pathlib import Path
from threading import Event, Lock
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from scanner.errors import InputError
from scanner.io import read_whole
from scanner.rendering import script, script_hash
from scanner.ui import Terminal
from scanner.viewing.opening import address, free_port, warning

_TOKEN = "token"
_FOREIGN = "This page answers to its own address only.\n"
_NO_REQUEST = "This is not a request for a page.\n"
_NO_TOKEN = "Open the address that the program has printed, with its token.\n"

# Only the browser knows its colour scheme; viser is told by the address.
_TO_THE_PAGE = """<!DOCTYPE html><meta charset="utf-8"><title>Opening …</title>
<script>location.replace(matchMedia("(prefers-color-scheme: dark)").matches ? "/?darkMode" : "/")</script>
"""
_PREFIX = "results"
_VIEWER = "viewer.js"
_STYLE = "page.css"
_BRAND = (0, 90, 150)


class OriginCheck:
    """The check of one server; `host` is the address that it serves at, `token` is part of the printed address.

    `inside` may answer admitted requests, in place of the page.
    """

    def __init__(self, host: str, inside: Callable[[str], Response | None] = lambda _: None) -> None:
        self._inside = inside
        own = socket.gethostname()
        self.token = secrets.token_urlsafe(16)
        self._names = {name.lower() for name in ("localhost", host, own, f"{own}.local")}
        self._cookie = f"roomscan-{secrets.token_hex(4)}"  # pages at other ports of this computer share its cookies

    def answer(self, path: str, headers: Mapping[str, str]) -> Response | None:
        """Return the response that replaces the page; None to let a request through."""
        asked = headers.get("Host", "")
        origin = headers.get("Origin")
        if not self._is_ours(asked) or (origin is not None and origin.partition("//")[2] != asked):
            return _response(http.HTTPStatus.FORBIDDEN, _FOREIGN)
        query = parse_qs(path.partition("?")[2])
        if self._knows(query.get(_TOKEN, [""])[0]):
            cookie = f"{self._cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            kind = {"Content-Type": "text/html; charset=utf-8", "Set-Cookie": cookie}
            return _response(http.HTTPStatus.OK, _TO_THE_PAGE, kind)
        if self._knows(self._of_cookie(headers.get("Cookie", ""))):
            return self._inside(path)
        return _response(http.HTTPStatus.FORBIDDEN, _NO_TOKEN)

    def _is_ours(self, asked: str) -> bool:
        """Whether a `Host` is an address, or a name that this computer gives itself."""
        try:
            name = urlsplit(f"//{asked}").hostname or ""
            return name in self._names or bool(ip_address(name))
        except ValueError:
            return False

    def _knows(self, token: str) -> bool:
        return secrets.compare_digest(token.encode(), self.token.encode())

    def _of_cookie(self, text: str) -> str:
        try:
            cookie = SimpleCookie(text).get(self._cookie)
        except CookieError:
            return ""
        return cookie.value if cookie else ""

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Servers that are started within ask this origin_check first.

        viser has no hook for it, but starts its server by this function of websockets.
        """
        serve = websockets.asyncio.server.serve
        setattr(websockets.asyncio.server, "serve", partial(_serve, serve, self))  # noqa: B010
        try:
            yield
        finally:
            setattr(websockets.asyncio.server, "serve", serve)  # noqa: B010


def _serve(
    serve: Callable[..., Any],
    origin_check: OriginCheck,
    *arguments: Any,
    process_request: Callable[[ServerConnection, Request], Any],
    **options: Any,
) -> Any:
    def asked(connection: ServerConnection, request: Request) -> Any:
        try:
            refused = origin_check.answer(request.path, request.headers)
            return process_request(connection, request) if refused is None else refused
        except (LookupError, OSError, ValueError):  # a duplicate header, or a name that no file can have
            return _response(http.HTTPStatus.BAD_REQUEST, _NO_REQUEST)

    return serve(*arguments, process_request=asked, **options)


def _response(status: http.HTTPStatus, body: str, headers: Mapping[str, str] | None = None) -> Response:
    data = body.encode()
    all_headers = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(data)), **(headers or {})}
    return Response(status, status.phrase, Headers(**all_headers), data)


class ServedFiles:
    """The folders that were offered so far."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._folders: dict[str, Path] = {}

    def link(self, path: Path) -> str:
        """The address of a file; its folder is offered from now on."""
        folder = path.parent.resolve()
        with self._lock:
            known = next((key for key, offered in self._folders.items() if offered == folder), None)
            key = known or f"{len(self._folders) + 1}-{folder.name}"
            self._folders[key] = folder
        return f"/{_PREFIX}/{quote(key)}/{quote(path.name)}"

    def answer(self, address: str) -> Response | None:
        """The file at an address; None where the address is not one of results."""
        first, _, rest = address.partition("?")[0].lstrip("/").partition("/")
        if first != _PREFIX:
            return None
        file = self._file([unquote(part) for part in rest.split("/")])
        if file is not None:
            with suppress(InputError):  # one that is a decompression bomb, or unreadable
                return _file_response(http.HTTPStatus.OK, read_whole(file), _headers(file))
        return _file_response(http.HTTPStatus.NOT_FOUND, b"There is no such file.\n", {"Content-Type": "text/plain"})

    def _file(self, parts: list[str]) -> Path | None:
        key, *names = parts
        with self._lock:
            folder = self._folders.get(key)
        if folder is None or not names or any(not name or "\0" in name for name in names):
            return None
        try:
            path = folder.joinpath(*names).resolve()  # also follows links
            return path if path.is_relative_to(folder) and path.is_file() else None
        except (OSError, RuntimeError):  # a name that is too long, or circular links
            return None


def _headers(path: Path) -> dict[str, str]:
    if path.suffix != ".html":
        return {
            "Content-Type": "application/octet-stream",
            "Content-Disposition": f"attachment; filename*=UTF-8''{quote(path.name)}",
        }
    policy = (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {script_hash(script(_VIEWER))}; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy}


def _file_response(status: http.HTTPStatus, body: bytes, headers: dict[str, str]) -> Response:
    all_headers = {"Content-Length": str(len(body)), "X-Content-Type-Options": "nosniff", **headers}
    return Response(status, status.phrase, Headers(**all_headers), body)


@dataclass(frozen=True)
class Serving:
    """A running server, its `address` with the token that opens it, and the `served_files` that it answers with."""

    server: viser.ViserServer
    address: str
    served_files: ServedFiles


@contextmanager
def serving(title: str, host: str, wanted_port: int | None) -> Iterator[Serving]:
    """A server for as long as the context lasts.

    Raises InputError if it cannot be had at that address.
    """
    port = free_port(host, wanted_port)
    # Malformed messages of clients are not shown in the terminal.
    logging.getLogger("websockets").addHandler(logging.NullHandler())
    served_files = ServedFiles()
    origin_check = OriginCheck(host, served_files.answer)
    with origin_check.watching(), redirect_stdout(StringIO()):  # viser prints a banner; the address is printed by us
        server = viser.ViserServer(host, port, label=title, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND)
        where = f"{address(host, server.get_port())}/?token={origin_check.token}"
        yield Serving(server, where, served_files)
    finally:
        server.stop()


def add_style(gui: viser.GuiApi, *, panel_left: bool = False) -> None:
    """Add the page's style to viser's; requires an open GUI container. What lies over the view is away from the panel,
    which is at the right or at the left.
    """
    gui.add_html(f'<style>{script(_STYLE)}</style><div class="scan-panel-{"left" if panel_left else "right"}"></div>')


def announce_page(where: str, host: str, terminal: Terminal, *, browser: bool) -> None:
    """Say where the page is, and open it if asked to."""
    if text := warning(host):
        terminal.show(text)
    terminal.show(f"Open {where} in a browser; Ctrl-C ends it.")
    if browser:
        webbrowser.open(where)


def wait() -> None:
    """Until Ctrl-C, which raises KeyboardInterrupt."""
    Event().wait()
