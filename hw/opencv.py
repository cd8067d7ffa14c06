"""Cameras that OpenCV opens: webcams by number (V4L2, UVC), network streams and pipelines by address."""

import os
import re
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager
from functools import partial
from math import inf
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

import cv2
import numpy as np
from pydantic import Field, StringConstraints, model_validator

from calib.numerics import Image
from hw.cameras import CameraInfo, refuse_other_setting, refuse_other_size
from hw.errors import DeviceError
from hw.rig import Capabilities, Frame
from hw.settings import CameraRigSettings, without_passwords
from hw.timing.devices import whole_periods
from hw.timing.frame_reader import FrameReader

if TYPE_CHECKING:
    from hw.motion_jpeg import MotionJpegStream

_OPENING_MS = 5000
_PROBED = 4  # camera numbers that are tried where the system has no list
# V4L2's values for "off": 1 for automatic exposure (V4L2_EXPOSURE_MANUAL), 0 for the others.
_AUTOMATICS = {
    "automatic exposure": (cv2.CAP_PROP_AUTO_EXPOSURE, 1.0),
    "automatic white balance": (cv2.CAP_PROP_AUTO_WB, 0.0),
    "automatic focus": (cv2.CAP_PROP_AUTOFOCUS, 0.0),
}
_EXPOSURE_UNIT_US = 100.0  # of V4L2's exposure_time_absolute
_LIMITS_US = (100.0, 1e6)  # OpenCV does not tell the driver's own
_TOLERANCE = 0.1  # of exposures, which drivers round
_BY_HAND = "Leave it out of the rig, set it with the camera's own tool or app, and turn its automatic off there."
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
_SLICE_S = 0.1  # longest delay of Ctrl-C
_V4L, _DEVICES = Path("/sys/class/video4linux"), Path("/dev")


Result = TypeVar("Result")


class OpenCVRigSettings(CameraRigSettings):
    """A camera that OpenCV opens, and a projector that is a screen."""

    backend: Literal["opencv"]
    camera: Annotated[int, Field(ge=0, le=99)] | Annotated[str, StringConstraints(min_length=1)] = Field(
        0, description="Number of a webcam, address of a stream (`http://…`, `rtsp://…`), or a GStreamer pipeline."
    )
    exposure_us: float | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="Exposure, rounded to whole refresh periods; webcams only; default: unchanged.",
    )
    gain: float | None = Field(None, description="Gain in the driver's unit; webcams only; default: unchanged.")
    codec: str | None = Field(
        None,
        pattern=r"^[A-Za-z0-9]{4}$",
        description="FourCC of a webcam's format; many need `MJPG` for their full size and rate.",
    )
    average: int = Field(
        2, ge=2, le=16, description="Frames averaged per picture; the first two verify that it is stable."
    )

    @property
    def has_gain(self) -> bool:
        """Whether the driver may accept a gain: webcams only."""
        return isinstance(self.camera, int)

    @model_validator(mode="after")
    def _settings_need_driver(self) -> Self:
        given = [key for key in ("exposure_us", "gain", "codec") if getattr(self, key) is not None]
        if given and not isinstance(self.camera, int):
            raise ValueError(f"{given[0]}: cannot be set for a stream; leave it out, and set it in the camera's app")
        return self


def load() -> Any:
    """This module: OpenCV is always installed."""
    return sys.modules[__name__]


def list_cameras() -> list[CameraInfo]:
    """Webcams of this computer; streams have no list."""
    numbers = sorted(int(path.name.removeprefix("video")) for path in _V4L.glob("video*")) if _V4L.is_dir() else []
    if not sys.platform.startswith("linux"):
        numbers = [*range(_PROBED)]
    return [camera for number in numbers if (camera := _looked_at(number)) is not None]


def _looked_at(number: int) -> CameraInfo | None:
    name_file = _V4L / f"video{number}" / "name"
    name = f"webcam {number}" + (f" ({name_file.read_text().strip()})" if name_file.is_file() else "")
    device = _DEVICES / f"video{number}"
    if device.exists() and not os.access(device, os.R_OK | os.W_OK):
        return CameraInfo(name, f"it may not be opened: {device} belongs to group {device.group()}, so join that")
    capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            return None
        size = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    finally:
        capture.release()
    return CameraInfo(name, f"{size[0]} × {size[1]}", ("backend: opencv", f"camera: {number}"), size)


def connect(settings: OpenCVRigSettings, size: tuple[int, int], refresh_hz: float) -> "OpenCVCamera":
    """Open the camera of these settings. Raises DeviceError."""
    return OpenCVCamera(settings, size, refresh_hz)


class OpenCVCamera(AbstractContextManager["OpenCVCamera"]):
    """A streaming camera from opening to closing (a context manager).

    Raises DeviceError if there is none, or if its frames are not of `size`, (width, height).
    """

    highest_level = 255

    def __init__(self, settings: OpenCVRigSettings, size: tuple[int, int], refresh_hz: float) -> None:
        self.size = size
        self.average = settings.average
        self._local = isinstance(settings.camera, int)
        self.name = f"webcam {settings.camera}" if self._local else without_passwords(str(settings.camera))
        self._refresh_hz = refresh_hz
        self._capture: cv2.VideoCapture | MotionJpegStream = self._connected(settings.camera)
        try:
            self._shape: tuple[int, ...] | None = None
            self._exposure_us: float | None = None
            self._exposure: Literal["settable", "readable", "unknown"] = "unknown"
            self.identity = {"camera": self.name, "video interface": self._capture.getBackendName()}
            self._configure(settings)
            self._first()
        except BaseException:
            self._capture.release()
            raise
        self.reader = FrameReader(self.name, self._read, self._capture.release)

    def __exit__(self, *_: object) -> None:
        self.reader.close()

    @property
    def capabilities(self) -> Capabilities:
        """Streaming; the exposure of a webcam may be settable, that of a network stream never is."""
        return Capabilities(streaming=True, exposure=self._exposure)

    @property
    def exposure_us(self) -> float | None:
        """The exposure in microseconds, as the driver reads it back; None if unknown."""
        return self._exposure_us

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """The shortest and the longest exposure that may be set, in microseconds."""
        return _LIMITS_US

    def expose_for(self, exposure_us: float) -> float:
        """Set the exposure to the nearest whole number of refresh periods; returns it in µs. Raises DeviceError."""
        wanted_us, _ = whole_periods(exposure_us, self._refresh_hz)
        self._capture.set(cv2.CAP_PROP_EXPOSURE, wanted_us / _EXPOSURE_UNIT_US)
        found_us = _EXPOSURE_UNIT_US * self._capture.get(cv2.CAP_PROP_EXPOSURE)
        refuse_other_setting(self.name, "exposure in µs", wanted_us, found_us, _TOLERANCE, _BY_HAND)
        self._exposure, self._exposure_us = "settable", found_us
        return found_us

    def grab(self) -> Frame:
        """The next frame of the stream. Raises DeviceError."""
        arrival = self.reader.following(self.reader.newest)
        return Frame(arrival.image, self.exposure_us, arrival.timestamp_ns)

    def _connected(self, camera: int | str) -> "cv2.VideoCapture | MotionJpegStream":
        """Motion JPEG over HTTP is read here, within limits that OpenCV does not have; OpenCV opens all others."""
        if isinstance(camera, str) and camera.lower().startswith(("http://", "https://")):
            from hw.motion_jpeg import open_motion_jpeg  # which loads HTTP

            limit_s = 1e-3 * _OPENING_MS
            try:
                stream = _interruptible(partial(open_motion_jpeg, self.name, camera, self.size, limit_s), limit_s)
            except TimeoutError:  # it answers, but does not come to an end
                raise DeviceError(
                    f"camera {self.name}: no whole answer within {limit_s:.3g} s. Check that the rig's camera is the "
                    "address of its stream; rerun."
                ) from None
            if stream is not None:
                return stream
        return _interruptible(partial(self._opened, camera))

    def _opened(self, camera: int | str) -> cv2.VideoCapture:
        if isinstance(camera, int):
            capture = cv2.VideoCapture(camera)
        else:
            # One thread: decoders with several delay frames.
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPENING_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _OPENING_MS]
            capture = cv2.VideoCapture(camera, cv2.CAP_FFMPEG, [*limits, cv2.CAP_PROP_N_THREADS, 1])
            if not capture.isOpened() and not _ADDRESS.match(camera):
                capture = cv2.VideoCapture(camera)  # a pipeline; an address would be tried again, without limits
        if not capture.isOpened():
            raise DeviceError(
                f"camera {self.name}: OpenCV cannot open it. Check that it is on, that the rig's camera is its number "
                "or address (scan devices lists numbers), and that no other program uses it, then rerun."
            )
        return capture

    def _configure(self, settings: OpenCVRigSettings) -> None:
        """Set what the driver accepts. Automatics that stay on are found later, by measuring the frames."""
        if not self._local:
            return
        if settings.codec is not None:
            self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*settings.codec))
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.size[0])
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.size[1])
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        for name, (key, off) in _AUTOMATICS.items():
            obeyed = self._capture.set(key, off) and self._capture.get(key) == off
            self.identity[name] = "off" if obeyed else "not in the driver's hand"
        self._learn_exposure(fixed=self.identity["automatic exposure"] == "off")
        if settings.exposure_us is not None:
            self.expose_for(settings.exposure_us)
            self.identity["exposure"] = f"{1e-3 * (self._exposure_us or 0):.4g} ms"
        if settings.gain is not None:
            self._capture.set(cv2.CAP_PROP_GAIN, settings.gain)
            actual_gain = self._capture.get(cv2.CAP_PROP_GAIN)
            refuse_other_setting(self.name, "gain", settings.gain, actual_gain, advice=_BY_HAND)
            self.identity["gain"] = f"{settings.gain:g}"

    def _learn_exposure(self, *, fixed: bool) -> None:
        """Read the exposure, and whether it is settable. The driver's value is only valid without automatics."""
        units = self._capture.get(cv2.CAP_PROP_EXPOSURE)
        if not fixed or units <= 0:
            return
        obeyed = self._capture.set(cv2.CAP_PROP_EXPOSURE, units)
        self._exposure, self._exposure_us = "settable" if obeyed else "readable", _EXPOSURE_UNIT_US * units

    def _first(self) -> None:
        """Check the first frame, and note whether frames are grey or colour."""
        taken = _interruptible(self._read)
        if taken is None:
            raise DeviceError(
                f"camera {self.name}: it opens, but delivers no frames. Check that no other program uses it; rerun."
            )
        self.identity["pixels"] = "grey" if taken[0].ndim == 2 else "colour (BGR)"

    def _read(self) -> tuple[Image, int | None] | None:
        """Wait for the next frame; returns it with the driver's time stamp, or None at the end of the stream."""
        there, taken = self._capture.read()
        if not there:
            return None
        image = self._expected(np.asarray(taken))
        stamp_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC) if self._local else 0.0
        return image, (int(1e6 * stamp_ms) or None)

    def _expected(self, image: np.ndarray) -> Image:
        height, width = image.shape[:2]
        refuse_other_size(self.name, self.size, (width, height))
        if image.dtype != np.uint8 or image.shape[2:] not in ((), (3,)) or self._shape not in (None, image.shape):
            format_text = "grey" if image.ndim == 2 else f"{image.shape[2]} channels"
            raise DeviceError(
                f"camera {self.name}: expected 8-bit frames, all grey or all of three channels (BGR), but it delivers "
                f"{format_text}, {image.dtype}. Choose another format with the rig's codec, or in the camera's app."
            )
        self._shape = image.shape
        return image


def _interruptible(work: Callable[[], Result], limit_s: float | None = None) -> Result:
    """The result of a call that does not return for Ctrl-C. Raises TimeoutError after `limit_s`.

    Without a limit it is a call of OpenCV, whose thread goes on to the library's own limit; the process waits for it
    when everything else is done, because a thread of it that returns while the interpreter ends would abort it.
    """
    done = Future[Result]()
    deadline_s = inf if limit_s is None else time.monotonic() + limit_s + _SLICE_S

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    Thread(target=run, name="opening", daemon=limit_s is not None).start()
    while True:
        try:
            return done.result(_SLICE_S)
        except TimeoutError:
            if done.done() or time.monotonic() > deadline_s:
                raise
