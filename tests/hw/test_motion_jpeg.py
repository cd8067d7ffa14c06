"""Pictures of a network camera are read within limits: what is cut off is lost, what is too large is not read.

The cameras are servers on 127.0.0.1 that send what a test gives them.
"""

import time
import tracemalloc
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedIOBase
from threading import Event, Thread

import cv2
import numpy as np
import pytest

from hw import opencv
from hw.errors import DeviceError
from hw.jpeg import is_whole_jpeg, jpeg_size
from hw.motion_jpeg import MotionJpegStream, open_motion_jpeg
from hw.opencv import OpenCVRigSettings

SIZE = (64, 48)
MULTIPART = "multipart/x-mixed-replace; boundary=edge"
Send = Callable[[BufferedIOBase], None]


def picture(level: int, size: tuple[int, int] = SIZE) -> bytes:
    image = np.full((size[1], size[0], 3), level, np.uint8)
    return bytes(cv2.imencode(".jpg", image)[1])


def part(content: bytes, *, length: int | None = None, told: bool = True, boundary: bytes = b"--edge") -> bytes:
    head = b"Content-Length: %d\r\n" % (len(content) if length is None else length) if told else b""
    return boundary + b"\r\nContent-Type: image/jpeg\r\n" + head + b"\r\n" + content + b"\r\n"


@contextmanager
def camera(send: Send, content_type: str = MULTIPART, login: str | None = None) -> Iterator[str]:
    """The address of a camera that answers a request with what `send` writes."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if login is not None and self.headers["Authorization"] != "Basic " + b64encode(login.encode()).decode():
                self.send_response(401)
                self.send_header("WWW-Authenticate", 'Basic realm="camera"')
                self.end_headers()
                return
            if self.path != "/video":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", content_type)
            self.end_headers()
            with suppress(ConnectionError):
                send(self.wfile)

        def log_message(self, *_: object) -> None:
            """No log."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/video"
    finally:
        server.shutdown()
        server.server_close()


def sends(*parts: bytes) -> Send:
    def send(file: BufferedIOBase) -> None:
        for content in parts:
            file.write(content)

    return send


def opened(address: str, limit_s: float = 20.0) -> MotionJpegStream:
    stream = open_motion_jpeg("phone", address, SIZE, limit_s)
    assert stream is not None
    return stream


def levels(stream: MotionJpegStream) -> list[int]:
    """Of all pictures up to the end of a stream."""
    values = []
    while (frame := stream.read())[0]:
        assert frame[1] is not None
        assert frame[1].shape == (SIZE[1], SIZE[0], 3)
        values.append(round(float(frame[1].mean())))
    stream.release()
    return values


@pytest.mark.parametrize("told", [True, False], ids=["length", "no length"])
@pytest.mark.parametrize("declared", ["edge", "--edge", '"edge"'])
@pytest.mark.parametrize("before", [b"", b"\r\n", b"a preamble\r\n"])
def test_pictures_come_in_order(told: bool, declared: str, before: bytes) -> None:
    stream = sends(before, *(part(picture(level), told=told) for level in (10, 90, 200)), b"--edge--\r\n")
    with camera(stream, f"multipart/x-mixed-replace; boundary={declared}") as address:
        assert levels(opened(address)) == [10, 90, 200]


@pytest.mark.parametrize("told", [True, False], ids=["length", "no length"])
@pytest.mark.parametrize(
    "broken",
    [picture(50)[: len(picture(50)) // 2], b"", b"text", picture(50)[:-2], picture(50)[2:]],
    ids=["half", "empty", "text", "no end", "no start"],
)
def test_a_picture_that_is_cut_off_is_lost(told: bool, broken: bytes) -> None:
    with camera(sends(*(part(content, told=told) for content in (picture(10), broken, picture(90), b"")))) as address:
        assert levels(opened(address)) == [10, 90]


def test_a_length_that_is_wrong_costs_its_picture() -> None:
    parts = part(picture(10)), part(picture(50), length=100), part(picture(90))
    with camera(sends(*parts)) as address:
        assert levels(opened(address)) == [10, 90]


def test_a_picture_of_another_size_is_named_before_it_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    with camera(sends(part(picture(10)), part(picture(90, (48, 64))))) as address:
        stream = opened(address)
        assert stream.read()[0]
        monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
        with pytest.raises(DeviceError, match=r"expected frames of 64 × 48, but it delivers 48 × 64"):
            stream.read()
        stream.release()


@pytest.mark.parametrize("told", [True, False], ids=["length", "no length"])
@pytest.mark.parametrize("lines", [True, False])
def test_a_part_of_2_gb_is_refused_before_it_is_read(told: bool, lines: bool) -> None:
    written = 0

    def send(file: BufferedIOBase) -> None:
        nonlocal written
        file.write(b"--edge\r\n" + (b"Content-Length: %d\r\n" % 2**31 if told else b"") + b"\r\n")
        block = (b"\n" if lines else b"\0") * 4096
        while written < 2**31:
            file.write(block)
            written += len(block)

    with camera(send) as address:
        stream = opened(address)
        tracemalloc.start()
        try:
            with pytest.raises(DeviceError, match="64 × 48, which need at most 77,824 bytes, but it sends one of"):
                stream.read()
            assert tracemalloc.get_traced_memory()[1] < 2**20
        finally:
            tracemalloc.stop()
            stream.release()
    assert written < 2**28  # what the kernel takes


def test_a_header_of_a_part_without_an_end_is_refused() -> None:
    def send(file: BufferedIOBase) -> None:
        file.write(b"--edge\r\n")
        while True:
            file.write(b"X" * 4096)

    with camera(send) as address:
        stream = opened(address)
        with pytest.raises(DeviceError, match="but it sends one of"):
            stream.read()
        stream.release()


@pytest.mark.parametrize("slice_s", [60.0, 0.02], ids=["silent", "a byte now and then"])
@pytest.mark.parametrize("after", [b"", b"--edge\r\nContent-Length: 900\r\n\r\n", part(picture(9)[:90])])
def test_a_camera_that_does_not_get_on_is_named(slice_s: float, after: bytes) -> None:
    ended = Event()

    def send(file: BufferedIOBase) -> None:
        file.write(after)
        while not ended.wait(slice_s):
            file.write(b"\0")

    with camera(send) as address:
        stream = opened(address, 0.3)
        seen = r" \(1 that came are cut off, or no JPEG\)" if after.endswith(b"\r\n") and len(after) > 80 else ""
        with pytest.raises(DeviceError, match=rf"phone: no whole picture for 0\.3 s{seen}\. Check"):
            stream.read()
        stream.release()
        ended.set()


def test_answers_that_are_no_motion_jpeg_are_left_to_opencv() -> None:
    with camera(sends(b"..."), "video/mp2t") as address:
        assert open_motion_jpeg("phone", address, SIZE, 20.0) is None
    with camera(sends(b"..."), "multipart/x-mixed-replace") as address:  # without a boundary
        assert open_motion_jpeg("phone", address, SIZE, 20.0) is None


def test_a_camera_with_a_password() -> None:
    with camera(sends(part(picture(10))), login="me:se/cret") as address:
        with pytest.raises(DeviceError, match=r"answers 401 Unauthorized and wants a user and a password.*USER:PASSW"):
            opened(address)
        assert levels(opened(address.replace("//", "//me:se%2Fcret@"))) == [10]


def test_an_address_without_a_camera_is_named() -> None:
    with camera(sends()) as address, pytest.raises(DeviceError, match=r"it answers 404 Not Found\. Check its path"):
        opened(address + "s")
    with pytest.raises(DeviceError, match=r"it does not answer .*refused"):
        opened(address)


def test_an_answer_that_does_not_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opencv, "_OPENING_MS", 300)
    ended = Event()

    class Slow(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            with suppress(ConnectionError):
                while not ended.wait(0.02):
                    self.wfile.write(b"X")

    server = ThreadingHTTPServer(("127.0.0.1", 0), Slow)
    server.daemon_threads = True
    Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_address[1]}/video"
    begun_s = time.monotonic()
    with pytest.raises(DeviceError, match=r"no whole answer within 0\.3 s"):
        opencv.connect(OpenCVRigSettings(backend="opencv", camera=address), SIZE, 60.0)
    assert 0.3 <= time.monotonic() - begun_s < 30
    ended.set()
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("size", [SIZE, (1, 1), (1920, 1080), (333, 77)])
@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_the_size_in_a_header_is_that_of_the_picture(
    size: tuple[int, int], progressive: int, channels: tuple[int, ...]
) -> None:
    image = np.zeros((size[1], size[0], *channels), np.uint8)
    content = bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1])
    assert jpeg_size(content) == size
    assert is_whole_jpeg(content)
    assert not any(is_whole_jpeg(content[:end]) for end in range(0, len(content) - 1, 7))
    assert jpeg_size(content[:2] + b"\xff\xff" + content[2:]) == size  # fill bytes
    assert [jpeg_size(content[:end]) for end in (0, 2, 20)] == [None] * 3
