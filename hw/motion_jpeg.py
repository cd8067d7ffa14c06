"""Motion JPEG over HTTP (`multipart/x-mixed-replace`), as telephones and network cameras send it, and its pictures.

OpenCV plays such streams, too, but it takes a part of any size into memory, completes a picture that is cut off with
grey, and scales one of another size.
"""

import time
from http.client import HTTPException, HTTPResponse
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit, urlunsplit
from urllib.request import (
    HTTPBasicAuthHandler,
    HTTPDigestAuthHandler,
    HTTPPasswordMgrWithDefaultRealm,
    OpenerDirector,
    build_opener,
)

import cv2
import numpy as np

from calib.numerics import Image
from hw.cameras import refuse_other_size
from hw.errors import DeviceError
from hw.jpeg import is_whole_jpeg, jpeg_size

_CHUNK = 1 << 16  # bytes
_HEADERS_BYTES = 1 << 16  # of a part; also those of a picture's file
_PIXEL_BYTES = 4  # noise at the highest quality needs fewer
_UNAUTHORISED = 401
_AS_STORED = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION


def open_motion_jpeg(name: str, address: str, size: tuple[int, int], limit_s: float) -> "MotionJpegStream | None":
    """Ask for an address, `http://` or `https://`; None if something else answers than Motion JPEG.

    `name` is the camera's in messages, `size` (width, height) that of its pictures, `limit_s` the longest silence.
    Raises DeviceError if nothing answers, or if it refuses.
    """
    opener, address = _opener(address)
    try:
        response = opener.open(address, timeout=limit_s)
    except HTTPError as error:
        error.close()
        advice = (
            "Write them into the address, http://USER:PASSWORD@…" if error.code == _UNAUTHORISED else "Check its path"
        )
        wanted = " and wants a user and a password" if error.code == _UNAUTHORISED else ""
        raise DeviceError(f"camera {name}: it answers {error.code} {error.reason}{wanted}. {advice}; rerun.") from error
    except (URLError, OSError) as error:
        raise DeviceError(
            f"camera {name}: it does not answer ({getattr(error, 'reason', error)}). Check that it is on, that the "
            "rig's camera is its address, and the network; rerun."
        ) from error
    except (HTTPException, ValueError):
        return None  # another protocol than HTTP, or an address that is none
    boundary = response.headers.get_boundary()
    if response.headers.get_content_type() != "multipart/x-mixed-replace" or boundary is None:
        response.close()
        return None
    return MotionJpegStream(name, response, boundary, size, limit_s)


def _opener(address: str) -> tuple[OpenerDirector, str]:
    """Who logs in with user and password of an address, and the address without them."""
    parts = urlsplit(address)
    passwords = HTTPPasswordMgrWithDefaultRealm()
    if parts.username is None:
        return build_opener(), address
    address = urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    passwords.add_password(None, address, unquote(parts.username), unquote(parts.password or ""))
    return build_opener(HTTPBasicAuthHandler(passwords), HTTPDigestAuthHandler(passwords)), address


class MotionJpegStream:
    """The pictures of a response, with those methods of cv2.VideoCapture that a stream needs.

    Pictures that are cut off or no JPEG are left out: frames that were lost.
    """

    def __init__(self, name: str, response: HTTPResponse, boundary: str, size: tuple[int, int], limit_s: float) -> None:
        self._name = name
        self._response = response
        # Some cameras declare their boundary with the dashes before it, some without.
        self._boundary = boundary.strip("-").encode("latin-1", "replace")
        self._size = size
        self._limit_s = limit_s
        self._most_bytes = _HEADERS_BYTES + _PIXEL_BYTES * size[0] * size[1]
        self._received = bytearray()
        self._deadline_s = 0.0

    def getBackendName(self) -> str:  # noqa: N802
        """Name of the interface."""
        return "Motion JPEG"

    def get(self, _: int) -> float:
        """No property is known."""
        return 0.0

    def set(self, _property: int, _value: float) -> bool:
        """No property can be set."""
        return False

    def release(self) -> None:
        """Close the connection."""
        self._response.close()

    def read(self) -> tuple[bool, Image | None]:
        """Wait for the next whole picture, (H, W, 3) in BGR; (False, None) at the end of the stream.

        Raises DeviceError if none comes within the time limit, if one of another size comes, or if one is announced
        that is larger than a picture of this size can be, before it is read.
        """
        self._deadline_s = time.monotonic() + self._limit_s
        broken = 0
        try:
            while (image := self._decoded(self._part())) is None:
                broken += 1
        except TimeoutError:
            damaged = f" ({broken} that came are cut off, or no JPEG)" if broken else ""
            raise DeviceError(
                f"camera {self._name}: no whole picture for {self._limit_s:.3g} s{damaged}. Check that it is on and "
                "sends, and its network, then rerun."
            ) from None
        except (OSError, HTTPException, EOFError):
            return False, None
        return True, image

    def _decoded(self, content: bytes) -> Image | None:
        size = jpeg_size(content)
        if size is None or not is_whole_jpeg(content):
            return None
        refuse_other_size(self._name, self._size, size)
        image = cv2.imdecode(np.frombuffer(content, np.uint8), _AS_STORED)
        return None if image is None else image.astype(np.uint8, copy=False)

    def _part(self) -> bytes:
        """Content of the next part."""
        while not self._is_boundary(self._line()):
            pass
        length = None
        while header := self._line().strip():
            key, _, value = header.partition(b":")
            if key.strip().lower() == b"content-length" and value.strip().isdigit():
                length = int(value)
        if length is None:
            return self._until_boundary()
        self._refuse_larger(length)
        while len(self._received) < length:
            self._receive()
        return self._taken(length)

    def _until_boundary(self) -> bytes:
        """Content of a part that does not tell its length. The boundary stays, for the next part."""
        content = bytearray()
        while not self._is_boundary(line := self._line()):
            content += line
            self._refuse_larger(len(content))
        self._received[:0] = line
        return bytes(content)

    def _is_boundary(self, line: bytes) -> bool:
        return line.startswith(b"--") and line.strip().strip(b"-") == self._boundary

    def _line(self) -> bytes:
        """Bytes up to the end of a line."""
        searched = 0
        while (end := self._received.find(b"\n", searched)) < 0:
            searched = len(self._received)
            self._refuse_larger(searched)
            self._receive()
        return self._taken(end + 1)

    def _taken(self, count: int) -> bytes:
        taken = bytes(self._received[:count])
        del self._received[:count]
        return taken

    def _receive(self) -> None:
        if time.monotonic() > self._deadline_s:
            raise TimeoutError
        chunk = self._response.read1(_CHUNK)
        if not chunk:
            raise EOFError
        self._received += chunk

    def _refuse_larger(self, count: int) -> None:
        if count > self._most_bytes:
            raise DeviceError(
                f"camera {self._name}: expected pictures of {self._size[0]} × {self._size[1]}, which need at most "
                f"{self._most_bytes:,} bytes, but it sends one of {count:,} or more. Check that the rig's camera is "
                "the address of its Motion JPEG, then rerun."
            )
