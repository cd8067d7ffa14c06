"""A GenICam camera (GigE Vision, USB3 Vision), reached through Aravis, triggered one frame at a time.

Observed with Aravis 0.8, and relied on here: a second program opens the camera read-only without an error; a frame
that lost packets arrives with a status instead of an error; a wait for a frame ignores Ctrl-C.
"""

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from statistics import median
from typing import Any

from hw.aravis.devices import Aravis, GLib, list_cameras, open_camera
from hw.aravis.frame_clock import FrameClock
from hw.aravis.settings import AravisRigSettings
from hw.aravis.setup import configure, read_back, start
from hw.cameras import differs, refuse_other_setting
from hw.errors import DeviceError, FrameLostError
from hw.rig import Capabilities, Frame
from hw.timing import ATTEMPTS, TRIGGER_LAG_S, nothing, whole_periods

__all__ = ["AravisCamera", "connect", "list_cameras"]

_SLICE_S = 0.1  # longest delay of Ctrl-C
_LATEST_FRAME_S = 1.0  # longest time from the end of an exposure to its frame
_QUIET_S = 0.5  # time for left-over frames to arrive after a disturbance
_SLOW_TRIGGER_S = 0.2  # Aravis repeats an unanswered command after 0.5 s, and the camera may have obeyed both
_STALE_S = 0.005  # stale frames are dropped this long before the end of an exposure
_IN_FLIGHT = 2  # frames of a free-running camera that may have begun before the request: one exposed, one read


def connect(settings: AravisRigSettings, size: tuple[int, int], refresh_hz: float) -> "AravisCamera":
    """Open the camera of these settings. Raises DeviceError."""
    exposure_us, periods = whole_periods(settings.exposure_us, refresh_hz)
    camera = AravisCamera(settings, size, exposure_us, refresh_hz)
    camera.identity["exposure in refresh periods"] = str(periods)
    return camera


class AravisCamera(AbstractContextManager["AravisCamera"]):
    """A camera from opening to closing (a context manager), with exposures triggered one at a time.

    `size` is (width, height) of the frames, `exposure_us` the first exposure. Later exposures are rounded to whole
    periods of `refresh_hz`. Raises DeviceError if there is no such camera, if another program uses it, or if it does
    not accept a setting.
    """

    def __init__(
        self, settings: AravisRigSettings, size: tuple[int, int], exposure_us: float, refresh_hz: float | None = None
    ) -> None:
        self.size = size
        self.name = settings.camera or "that was found"
        self._free_running = settings.trigger != "software"
        self._disturbed = False
        self._silent = False
        self._triggered_s = 0.0
        self.late_s = 0.0
        # Keyed by exposure, because some cameras stamp its end. Short enough for retaken frames to change the median.
        self._offsets_s: dict[float, deque[float]] = defaultdict(lambda: deque(maxlen=2 * ATTEMPTS - 3))
        self._refresh_hz = refresh_hz
        self._discarded = _IN_FLIGHT
        self._clock = FrameClock()
        self._arrived: Any | None = None
        self._camera = open_camera(settings.camera)
        with self._errors("cannot be set up"):
            self.name = " ".join([self._camera.get_vendor_name(), self._camera.get_model_name(), _serial(self._camera)])
            self._check_control()
            self._format = configure(self._camera, self.name, settings, size, exposure_us)
            self.exposure_s = self._camera.get_exposure_time() / 1e6
            limits = self._camera.get_exposure_time_bounds()
            self.exposure_limits_us = (float(limits.min), float(limits.max))
            self.highest_level = (1 << self._format.bits) - 1
            self._stream = start(self._camera, self.name, settings)
            self.identity = read_back(self._camera, self.name)

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def capabilities(self) -> Capabilities:
        """Time stamps tell when the exposures of a free-running camera begin, so the clock is known."""
        return Capabilities(exposure="settable", clock=True)

    @property
    def exposure_us(self) -> float:
        """The exposure in microseconds, as read back from the camera."""
        return float(1e6 * self.exposure_s)

    @property
    def wait_s(self) -> float:
        """Longest time from `expose` to the begin of the exposure: one frame interval of a free-running camera."""
        return self._clock.interval_s if self._free_running else 0.0

    def expose_for(self, exposure_us: float) -> float:
        """Set the exposure to the nearest whole number of refresh periods; returns it in microseconds.

        Raises DeviceError if it is out of the camera's range, or if the camera sets another one.
        """
        if self._refresh_hz is not None:
            exposure_us, _ = whole_periods(exposure_us, self._refresh_hz)
        shortest, longest = self.exposure_limits_us
        if not shortest <= exposure_us <= longest:
            raise DeviceError(
                f"camera {self.name}: an exposure of {exposure_us:.0f} µs is wanted, but it supports {shortest:.0f} to "
                f"{longest:.0f} µs. Set exposure_us, or exposures_us, within this range."
            )
        if not differs(exposure_us, self.exposure_us):
            return self.exposure_us
        with self._errors("does not change its exposure"):
            self._camera.set_exposure_time(exposure_us)
            found_us = self._camera.get_exposure_time()
        refuse_other_setting(self.name, "exposure in µs", exposure_us, found_us)
        self.exposure_s = found_us / 1e6
        self._discarded = _IN_FLIGHT + 1  # one more may have begun with the previous exposure
        self._clock = FrameClock()
        return self.exposure_us

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose one frame, and wait until the exposure is over.

        Returns the time of the trigger (monotonic clock). `meanwhile` is called once the trigger was sent. Raises
        DeviceError if the camera does not answer.
        """
        if self._disturbed:
            self._run_dry()
        self._drain()
        self._triggered_s = time.monotonic()
        if self._free_running:
            return self._follow(meanwhile)
        with self._errors("does not answer"):
            self._camera.software_trigger()
        told_s = time.monotonic()
        self._disturbed = told_s - self._triggered_s > _SLOW_TRIGGER_S
        meanwhile()
        time.sleep(max(0.0, self._triggered_s + self.exposure_s - _STALE_S - time.monotonic()))
        self._drop_stale()
        time.sleep(max(0.0, told_s + self.exposure_s - time.monotonic()))
        return self._triggered_s

    def _drop_stale(self) -> None:
        """Drop frames that arrive before this exposure can be over: they belong to an earlier one."""
        end_s = self._triggered_s + self.exposure_s
        while self._arrived is None and (buffer := self._stream.try_pop_buffer()) is not None:
            if time.monotonic() >= end_s and _arrival_s(buffer) >= self._triggered_s:
                self._arrived = buffer  # this thread, or `meanwhile`, took longer: the frame is the new one
            else:
                self._recycle(buffer)

    def _follow(self, meanwhile: Callable[[], None]) -> float:
        """Wait for a frame whose exposure begins now or later; returns when it began, by its time stamp.

        Without time stamps a fixed number of frames is discarded, which may have begun before.
        """
        asked_s, discarded = time.monotonic(), self._discarded
        meanwhile()
        deadline_s = asked_s + (discarded + 1) * self.exposure_s + _LATEST_FRAME_S
        while (buffer := self._pop(deadline_s - time.monotonic())) is not None:
            stamp_s = buffer.get_timestamp() / 1e9
            begun_s = self._clock.begun_s(buffer.get_frame_id(), stamp_s, _arrival_s(buffer), self.exposure_s)
            tells = self._clock.has_time_stamps and self._discarded <= _IN_FLIGHT
            if begun_s >= asked_s if tells else discarded == 0:
                break
            self._recycle(buffer)
            discarded -= 1
        self._arrived = buffer
        self._discarded = _IN_FLIGHT
        return begun_s if buffer is not None and tells else asked_s

    def collect(self) -> Frame:
        """The last exposed frame. Raises FrameLostError if it does not arrive complete, DeviceError."""
        if self._disturbed:
            raise FrameLostError("the camera was slow to answer")
        buffer, self._arrived = self._arrived, None
        if buffer is None and not self._free_running:
            buffer = self._pop(_LATEST_FRAME_S)
        if buffer is None:
            self._disturbed = True
            self._check_control()
            raise FrameLostError(f"no frame within {_LATEST_FRAME_S:.1f} s of its exposure")
        try:
            return self._frame(buffer)
        finally:
            self._recycle(buffer)

    def grab(self) -> Frame:
        """Expose and collect."""
        self.expose()
        return self.collect()

    def close(self) -> None:
        """Stop the acquisition and release the camera."""
        if not self._silent:
            with suppress(GLib.Error):  # the camera may be gone
                self._camera.stop_acquisition()
        del self._stream
        del self._camera

    def _check_control(self) -> None:
        if not self._camera.get_device().is_controller():
            raise DeviceError(
                f"camera {self.name}: another program controls it, or it has lost the connection. Close the other "
                "program, check cable and power, then rerun."
            )

    def _frame(self, buffer: Any) -> Frame:
        status = buffer.get_status()
        if status != Aravis.BufferStatus.SUCCESS:
            raise FrameLostError(f"incomplete: {status.value_nick}")
        width, height = buffer.get_image_width(), buffer.get_image_height()
        if (width, height) != self.size:
            raise FrameLostError(f"{width} × {height} instead of {self.size[0]} × {self.size[1]}")
        timestamp_ns = buffer.get_timestamp()
        if not self._free_running:
            self._refuse_late(timestamp_ns / 1e9 - self._triggered_s)
        image = self._format.image(buffer.get_data(), width, height)
        return Frame(image, exposure_us=1e6 * self.exposure_s, timestamp_ns=timestamp_ns)

    def _refuse_late(self, offset_s: float) -> None:
        """Raise FrameLostError if the trigger took effect late, and the frame may show the next picture.

        The offset between both clocks is compared with its median over the last frames, which follows drift.
        """
        offsets_s = self._offsets_s[self.exposure_s]
        usual_s = median(offsets_s) if offsets_s else offset_s
        offsets_s.append(offset_s)
        self.late_s = offset_s - min(offsets_s)
        if offset_s - usual_s > TRIGGER_LAG_S:
            raise FrameLostError(f"exposed {1e3 * (offset_s - usual_s):.0f} ms late")

    def _pop(self, timeout_s: float) -> Any | None:
        """The next buffer, whatever its status; None after the timeout. Can be interrupted by Ctrl-C."""
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            buffer = self._stream.timeout_pop_buffer(int(1e6 * min(left_s, _SLICE_S)))
            if buffer is not None:
                return buffer
        return None

    def _recycle(self, buffer: Any | None) -> None:
        if buffer is not None:
            self._stream.push_buffer(buffer)

    def _drain(self) -> None:
        self._recycle(self._arrived)
        self._arrived = None
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(buffer)

    def _run_dry(self) -> None:
        """Wait until no more frames arrive: a repeated trigger may have exposed superfluous ones."""
        while (buffer := self._pop(self.exposure_s + _QUIET_S)) is not None and not self._free_running:
            self._recycle(buffer)
        self._recycle(buffer)
        self._disturbed = False

    @contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        try:
            yield
        except (GLib.Error, ValueError) as error:
            self._silent = isinstance(error, GLib.Error)
            message = error.message if isinstance(error, GLib.Error) else str(error)
            raise DeviceError(
                f"camera {self.name}: {what}: {message}. Check cable and power, the configuration, and "
                "what scan devices lists, then rerun."
            ) from error


def _arrival_s(buffer: Any) -> float:
    """When the first packet of a frame arrived, in seconds of the monotonic clock."""
    return float(buffer.get_system_timestamp() / 1e9 - time.time() + time.monotonic())


def _serial(camera: Any) -> str:
    return str(camera.get_device_serial_number())
