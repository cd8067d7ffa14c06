"""A simulated webcam: fixed frame rate, rolling shutter, automatic exposure, JPEG, an output queue.

Its server sends Motion JPEG over HTTP, like those of telephones and network cameras.
"""

import socket
import time
from collections import deque
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Event, Thread
from typing import Self

import cv2
import numpy as np

from hw.errors import DeviceError
from hw.loopback.screen import ScreenLight
from hw.loopback.settings import Conditions, WebcamSettings
from hw.simulated import Light, SimulatedRoom

_BANDS = 16  # of rows that are exposed together
_COLOURS = (0.75, 1.0, 0.9)  # of white, in the order blue, green, red
_NOISES = 8  # precomputed noise fields, each used with a random shift
_TARGET_LEVEL = 90.0  # mean grey level that automatic exposure aims at
_SPEED = 0.15  # of the way there, from frame to frame
_MOST_GAIN = 8.0


class Webcam:
    """Takes frames of a simulated room lit by a screen, and sends each as JPEG, while the `with` block runs.

    The exposure is `white_exposure_us`. At gain 1, white then reaches 85 % of the range.
    """

    def __init__(
        self,
        room: SimulatedRoom,
        screen: ScreenLight,
        settings: WebcamSettings,
        white_exposure_us: float,
        send: Callable[[bytes], None],
    ) -> None:
        self._room, self._screen, self._settings, self._send = room, screen, settings, send
        self._exposure_s = white_exposure_us / 1e6
        self._rng = np.random.default_rng()
        optics = room.room.camera.optics
        self._noises = self._rng.standard_normal((_NOISES, optics.height, optics.width, 3), np.float32)
        self._gain = 1.0
        self._queue: deque[bytes] = deque()
        self._ending = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self.conditions = Conditions()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        period_s = 1 / self._settings.frames_per_s
        begin_s = time.monotonic()
        last = b""
        while not self._ending.is_set():
            conditions = self.conditions
            if conditions.fault != "frozen" or not last:
                last = self._jpeg(self._exposed(begin_s), conditions.fault)
            self._deliver(last, conditions)
            begin_s = max(begin_s + period_s, time.monotonic() - period_s)  # a computer that is busy drops frames
            time.sleep(max(0.0, begin_s - time.monotonic()))

    def _deliver(self, jpeg: bytes, conditions: Conditions) -> None:
        """Queue a frame and send the oldest; drop, repeat or delay some as the conditions say."""
        if conditions.fault == "silent" or self._rng.random() < conditions.dropped_frames:
            return
        self._queue.append(jpeg)
        if len(self._queue) > self._settings.queue:
            time.sleep(conditions.sending_jitter_ms / 1e3 * self._rng.random())
            oldest = self._queue.popleft()
            self._send(oldest)
            if self._rng.random() < conditions.repeated_frames:
                self._send(oldest)

    def _exposed(self, begin_s: float) -> Light:
        """Electrons (H, W) of a frame whose first row starts at `begin_s`; waits until the last row is exposed."""
        readout_s = self._settings.readout_ms / 1e3
        end_s = begin_s + readout_s + self._exposure_s
        time.sleep(max(0.0, self._screen.decided_s(end_s) - time.monotonic()))
        self._screen.look()
        height = self._noises.shape[1]
        electrons = np.zeros(self._noises.shape[1:3], np.float32)
        for rows in np.array_split(np.arange(height), _BANDS):
            since_s = begin_s + readout_s * rows[0] / height
            for share, light in self._screen.shares(since_s, since_s + self._exposure_s):
                electrons[rows] += np.float32(share) * light[rows]
        time.sleep(max(0.0, end_s - time.monotonic()))
        return electrons

    def _jpeg(self, electrons: Light, fault: str) -> bytes:
        noise = np.roll(self._noises[self._rng.integers(_NOISES)], self._rng.integers(electrons.shape[1]), axis=1)
        light = electrons[:, :, None] * np.float32(self._gain) * np.array(_COLOURS, np.float32)
        image: np.ndarray = self._room.sensor.read_with(light, noise.copy())
        self._adapt(image)
        if fault == "rotated":
            image = cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE)
        quality = [cv2.IMWRITE_JPEG_QUALITY, self._settings.jpeg_quality]
        return bytes(cv2.imencode(".jpg", image[:, :, 1] if fault == "grey" else image, quality)[1])

    def _adapt(self, image: np.ndarray) -> None:
        """Automatic exposure, here by gain alone: adapt the gain of the next frame."""
        if not self.conditions.automatic_exposure:
            self._gain = 1.0
            return
        wanted = self._gain * _TARGET_LEVEL / max(1.0, float(image.mean()))
        self._gain = float(np.clip(self._gain * (wanted / self._gain) ** _SPEED, 1 / _MOST_GAIN, _MOST_GAIN))


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
