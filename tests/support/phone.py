"""A telephone that sees a simulated room and streams it as Motion JPEG from this process."""

import socket
from collections import deque
from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Self

import cv2
import numpy as np

from hw.loopback import MjpegServer
from hw.simulated import SimulatedRoom

PERIOD_S = 1 / 60
_NOISE = 1.0  # grey levels
_QUEUE = 2  # frames that wait before one leaves


class Phone:
    """Streams from `address` while the `with` block lasts. `changed` modifies each frame (H, W, 3); None drops it.
    `stop` ends the server too, and `connect` starts again.
    """

    def __init__(self, room: SimulatedRoom) -> None:
        self._room = room
        self._rng = np.random.default_rng(0)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = int(probe.getsockname()[1])
        self.address = f"http://127.0.0.1:{self._port}/video"
        self._server: MjpegServer | None = None
        self._changing = Lock()
        self._ending = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self.changed: Callable[[np.ndarray], np.ndarray | None] = lambda image: image
        self.shown = 0
        self._light: np.ndarray | None = None

    def __enter__(self) -> Self:
        self.connect()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.stop()

    def connect(self) -> None:
        with self._changing:  # one thread may stop it, and another want it back at once
            self._server = MjpegServer("127.0.0.1", self._port, 3).__enter__()

    def stop(self) -> None:
        with self._changing:
            if self._server is not None:
                self._server.__exit__()
            self._server = None

    def light(self, picture: np.ndarray) -> None:
        """Set the picture that the projector shows."""
        self._light = self._room.electrons(picture) * (255 / self._room.sensor.full_well_electrons)
        self.shown += 1

    def _run(self) -> None:
        waiting: deque[np.ndarray] = deque()
        while not self._ending.wait(PERIOD_S):
            if self._light is None:
                continue
            seen = self._light[:, :, None] * (0.8, 1.0, 0.9) + _NOISE * self._rng.standard_normal(
                (*self._light.shape, 3)
            )
            waiting.append(np.rint(seen).clip(0, 255).astype(np.uint8))
            if len(waiting) <= _QUEUE:
                continue
            image, server = self.changed(waiting.popleft()), self._server
            if image is not None and server is not None:
                server.send(bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]))
