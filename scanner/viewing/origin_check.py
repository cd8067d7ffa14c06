"""Access control of the page: only who has its address, and only from the page itself.

A browser lets any website open a websocket to this computer. So three things are checked. The `Origin` of a request
must be the page's own. Its `Host` must not be a name that a foreign DNS server could resolve to this computer (DNS
rebinding). And it must carry a token from the printed address: in the query of the first request, which is answered
with a cookie, and in that cookie from then on.
"""

import http
import secrets
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

_TOKEN = "token"
_FOREIGN = "This page answers to its own address only.\n"
_NO_REQUEST = "This is not a request for a page.\n"
_NO_TOKEN = "Open the address that the program has printed, with its token.\n"


# Only the browser knows its colour scheme; viser is told by the address.
_TO_THE_PAGE = """<!DOCTYPE html><meta charset="utf-8"><title>Opening …</title>
<script>location.replace(matchMedia("(prefers-color-scheme: dark)").matches ? "/?darkMode" : "/")</script>
"""


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
