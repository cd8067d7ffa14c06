"""Files of results at addresses of the page's server, so that a report opens with its links and pictures.

Only files in offered folders are served, for any address. A result may be of unknown origin: its pages run only the
report's own viewer script, and load nothing; everything else is downloaded, never shown.
"""

import http
from contextlib import suppress
from pathlib import Path
from threading import Lock
from urllib.parse import quote, unquote

from websockets.datastructures import Headers
from websockets.http11 import Response

from scanner.errors import InputError
from scanner.io import read_whole
from scanner.rendering import script, script_hash

_PREFIX = "results"
_VIEWER = "viewer.js"


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
                return _response(http.HTTPStatus.OK, read_whole(file), _headers(file))
        return _response(http.HTTPStatus.NOT_FOUND, b"There is no such file.\n", {"Content-Type": "text/plain"})

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


def _response(status: http.HTTPStatus, body: bytes, headers: dict[str, str]) -> Response:
    all_headers = {"Content-Length": str(len(body)), "X-Content-Type-Options": "nosniff", **headers}
    return Response(status, status.phrase, Headers(**all_headers), body)
