"""A server of Motion JPEG over HTTP, like those of telephones and network cameras."""

import socket
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Thread
from typing import Self

from hw.errors import DeviceError

_BOUNDARY = "frame"


class MjpegServer:
    """Serves http://ADDRESS:PORT/video while the `with` block runs; `send` sends a frame to every client.

    At most `queue` frames wait for a slow client. Raises DeviceError if the port is taken.
    """

    def __init__(self, address: str, port: int, queue: int) -> None:
        self._arrived = Condition()
        self._frames: deque[tuple[int, bytes]] = deque(maxlen=queue)
        self._count = 0
        self._ended = False
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:  # the library's name
                outer._serve(self)

            def log_message(self, *_: object) -> None:
                """No log of requests."""

        try:
            self._server = ThreadingHTTPServer((address, port), Handler)
        except OSError as error:
            raise DeviceError(f"loopback webcam: {address} port {port}: {error.strerror}") from error
        self._server.daemon_threads = True

    def __enter__(self) -> Self:
        Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._arrived:
            self._ended = True
            self._arrived.notify_all()
        self._server.shutdown()
        self._server.server_close()

    def send(self, jpeg: bytes) -> None:
        """Send a frame to all clients."""
        with self._arrived:
            self._frames.append((self._count, jpeg))
            self._count += 1
            self._arrived.notify_all()

    def _serve(self, request: BaseHTTPRequestHandler) -> None:
        if request.path != "/video":
            request.send_error(404)
            return
        request.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
        request.send_response(200)
        request.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        request.end_headers()
        number = self._count - 1
        try:
            while (numbered := self._next(number)) is not None:
                number, jpeg = numbered
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                request.wfile.write(head.encode() + jpeg + b"\r\n")
        except ConnectionError:
            return  # the client has gone

    def _next(self, number: int) -> tuple[int, bytes] | None:
        """Wait for the first queued frame after this number; None when the server ends."""
        with self._arrived:
            while not self._ended:
                numbered = next((frame for frame in self._frames if frame[0] > number), None)
                if numbered is not None:
                    return numbered
                self._arrived.wait()
        return None
