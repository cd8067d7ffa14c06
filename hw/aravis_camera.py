"""A GenICam camera (GigE Vision, USB3 Vision), reached through Aravis; the only file that imports gi.

What was measured about Aravis 0.8 and is built upon here: an impossible setting is silently clipped unless ranges are
checked; a second program opens the camera read-only without being told; a frame that lost packets arrives with a status
instead of an error; a wait for a frame ignores Ctrl-C until it is over.
"""

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from statistics import median
from typing import Any, Self

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402  # only after the version is chosen

from hw.cameras import CameraInfo, not_found  # noqa: E402
from hw.errors import DeviceError, FrameLostError  # noqa: E402
from hw.exposures import whole_periods  # noqa: E402
from hw.frame_clock import FrameClock  # noqa: E402
from hw.pixel_formats import PixelFormat, pixel_format  # noqa: E402
from hw.receive_buffer import receive_buffer  # noqa: E402
from hw.rig import Frame  # noqa: E402
from hw.settings import AravisRigSettings  # noqa: E402
from hw.timed_devices import ATTEMPTS, TRIGGER_LAG_S, nothing  # noqa: E402

_BUFFERS = 4
_SLICE_S = 0.1  # Ctrl-C waits at most so long
_LATEST_FRAME_S = 1.0  # a frame takes at most so long from the end of its exposure
_QUIET_S = 0.5  # after a disturbance, the camera is given so long to deliver what is left of it
_SLOW_TRIGGER_S = 0.2  # an unanswered command is repeated after 0.5 s, and the camera may have heard both
_STALE_S = 0.005  # before the end of an exposure, what has arrived is looked through
_IN_FLIGHT = 2  # frames of a free-running camera that may have begun before they were asked for: one exposed, one read
_SETTING_TOLERANCE = 0.01
_AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")


def list_cameras() -> list[CameraInfo]:
    """All cameras that answer, with sensor size and formats of those that nobody else uses. Takes seconds."""
    return [_with_abilities(info) for info in _discover()]


def _discover() -> list[CameraInfo]:
    Aravis.update_device_list()
    return [
        CameraInfo(
            Aravis.get_device_id(index),
            Aravis.get_device_vendor(index) or "",
            Aravis.get_device_model(index) or "",
            Aravis.get_device_serial_nbr(index) or "",
            Aravis.get_device_address(index) or "",
        )
        for index in range(Aravis.get_n_devices())
    ]


def _with_abilities(info: CameraInfo) -> CameraInfo:
    try:
        camera = Aravis.Camera.new(info.device_id)
        size = camera.get_sensor_size()
        formats = tuple(camera.dup_available_pixel_formats_as_strings())
    except GLib.Error:
        return info  # it is there, but someone else uses it or the network does not let us in
    return replace(info, sensor_size=(size.width, size.height), pixel_formats=formats)


class AravisCamera:
    """A camera from opening to closing (a context manager), with exposures triggered one at a time.

    `size` is that of the frames, (width, height); `exposure_us` the wanted exposure, `refresh_hz` what later ones are
    rounded to whole periods of. Raises DeviceError if there is no such camera, if another program uses it, or if it
    does not accept a setting.
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
        # Of each exposure, for some cameras' clocks note its end. Retaken frames outvote the deque before they run out.
        self._offsets_s: dict[float, deque[float]] = defaultdict(lambda: deque(maxlen=2 * ATTEMPTS - 3))
        self._refresh_hz = refresh_hz
        self._discarded = _IN_FLIGHT
        self._clock = FrameClock()
        self._arrived: Any | None = None
        self._camera = _open(settings.camera)
        with self._errors("cannot be set up"):
            self.name = " ".join([self._camera.get_vendor_name(), self._camera.get_model_name(), _serial(self._camera)])
            self._check_control()
            self._format = self._configure(settings, exposure_us)
            self.exposure_s = self._camera.get_exposure_time() / 1e6
            limits = self._camera.get_exposure_time_bounds()
            self.exposure_limits_us = (float(limits.min), float(limits.max))
            self.highest_level = (1 << self._format.bits) - 1
            self._stream = self._start(settings)
            self.identity = self._read_back()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def exposure_us(self) -> float:
        """The exposure of all frames from now on, as the camera says."""
        return float(1e6 * self.exposure_s)

    @property
    def wait_s(self) -> float:
        """How long after `expose` its exposure begins at most: with the camera's next frame, if it is not told."""
        return self._clock.interval_s if self._free_running else 0.0

    def expose_for(self, exposure_us: float) -> float:
        """Expose all frames from now on for the nearest whole number of refresh periods; returns how long that is.

        Raises DeviceError if it is out of the camera's range, or if the camera makes something else of it.
        """
        if self._refresh_hz is not None:
            exposure_us, _ = whole_periods(exposure_us, self._refresh_hz)
        shortest, longest = self.exposure_limits_us
        if not shortest <= exposure_us <= longest:
            raise DeviceError(
                f"camera {self.name}: an exposure of {exposure_us:.0f} µs is wanted, but it can make {shortest:.0f} to "
                f"{longest:.0f} µs. Ask for an exposure_us, or exposures_us, that the camera can do."
            )
        if abs(exposure_us - self.exposure_us) <= _SETTING_TOLERANCE * exposure_us:
            return self.exposure_us
        with self._errors("does not change its exposure"):
            self._camera.set_exposure_time(exposure_us)
            found_us = self._camera.get_exposure_time()
        self._expect("exposure in µs", exposure_us, found_us)
        self.exposure_s = found_us / 1e6
        self._discarded = _IN_FLIGHT + 1  # one more may have begun with the exposure before
        self._clock = FrameClock()
        return self.exposure_us

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose one frame of what is before the camera from now on; returns when the exposure is over.

        Returns the moment of its trigger (monotonic clock). `meanwhile` is called when the camera has been told. Raises
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
        """What has arrived before an exposure may be over, the camera having obeyed at once, is of an earlier one."""
        end_s = self._triggered_s + self.exposure_s
        while time.monotonic() < end_s and (buffer := self._stream.try_pop_buffer()) is not None:
            if time.monotonic() >= end_s and _came_s(buffer) >= self._triggered_s:
                self._arrived = buffer  # whoever looked was held up
            else:
                self._recycle(buffer)

    def _follow(self, meanwhile: Callable[[], None]) -> float:
        """Wait for a frame whose exposure begins now or later; when it did, as far as time stamps tell.

        Where they do not, frames are counted: some may have begun before.
        """
        asked_s, discarded = time.monotonic(), self._discarded
        meanwhile()
        deadline_s = asked_s + (discarded + 1) * self.exposure_s + _LATEST_FRAME_S
        while (buffer := self._pop(deadline_s - time.monotonic())) is not None:
            stamp_s = buffer.get_timestamp() / 1e9
            begun_s = self._clock.begun_s(buffer.get_frame_id(), stamp_s, _came_s(buffer), self.exposure_s)
            tells = self._clock.tells and self._discarded <= _IN_FLIGHT
            if begun_s >= asked_s if tells else discarded == 0:
                break
            self._recycle(buffer)
            discarded -= 1
        self._arrived = buffer
        self._discarded = _IN_FLIGHT
        return begun_s if buffer is not None and tells else asked_s

    def collect(self) -> Frame:
        """The frame that was exposed last. Raises FrameLostError if it does not arrive whole, DeviceError."""
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
        """Stop, and leave the camera to others."""
        if not self._silent:
            with suppress(GLib.Error):  # it may be gone by now; nobody waits for more frames
                self._camera.stop_acquisition()
        del self._stream
        del self._camera

    def _check_control(self) -> None:
        if not self._camera.get_device().is_controller():
            raise DeviceError(
                f"camera {self.name}: another program controls it, or it has lost the connection. Close the other "
                "program, check cable and power, then rerun."
            )

    def _configure(self, settings: AravisRigSettings, exposure_us: float) -> PixelFormat:
        camera = self._camera
        camera.set_range_check_policy(Aravis.RangeCheckPolicy.ENABLE)
        camera.set_acquisition_mode(Aravis.AcquisitionMode.CONTINUOUS)
        if settings.binning > 1 or camera.is_binning_available():
            camera.set_binning(settings.binning, settings.binning)
        camera.set_pixel_format_from_string(settings.pixel_format)
        self._set_region(settings.offset_px)
        for feature in _AUTOMATICS:
            if camera.is_feature_available(feature):
                camera.set_string(feature, "Off")
        if camera.is_feature_available("GammaEnable"):
            camera.set_boolean("GammaEnable", False)
        camera.set_exposure_time(exposure_us)
        self._expect("exposure in µs", exposure_us, camera.get_exposure_time())
        if settings.gain is not None:
            camera.set_gain(settings.gain)
            self._expect("gain", settings.gain, camera.get_gain())
        if settings.trigger == "free-run":
            camera.clear_triggers()
        else:
            camera.set_trigger("Software" if settings.trigger == "software" else settings.trigger_line)
        return pixel_format(camera.get_pixel_format_as_string())

    def _set_region(self, offset_px: tuple[int, int] | None) -> None:
        camera, (width, height) = self._camera, self.size
        camera.set_region(0, 0, width, height)
        if offset_px is None:
            room = (camera.get_width_bounds().max - width, camera.get_height_bounds().max - height)
            steps = (camera.get_x_offset_increment(), camera.get_y_offset_increment())
            offset_px = (_centred(room[0], steps[0]), _centred(room[1], steps[1]))
        if offset_px != (0, 0):
            camera.set_region(*offset_px, width, height)
        region = camera.get_region()
        self._expect("width in pixels", width, region.width)
        self._expect("height in pixels", height, region.height)

    def _expect(self, what: str, wanted: float, found: float) -> None:
        if abs(found - wanted) > _SETTING_TOLERANCE * abs(wanted):
            raise DeviceError(
                f"camera {self.name}: wanted {wanted:g} as {what}, but the camera made it {found:g}. "
                "Change the configuration to what the camera can do."
            )

    def _start(self, settings: AravisRigSettings) -> Any:
        camera = self._camera
        if camera.is_gv_device():
            if settings.packet_size is None:
                camera.gv_auto_packet_size()
            else:
                camera.gv_set_packet_size(settings.packet_size)
                self._expect("packet size", settings.packet_size, camera.gv_get_packet_size())
            stream = self._network_stream()
        else:
            stream = camera.create_stream(None, None)
        for _ in range(_BUFFERS):
            stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
        camera.start_acquisition()
        return stream

    def _network_stream(self) -> Any:
        """Through a plain socket, where that keeps whole frames. What Aravis takes otherwise, if it may (as root), is a
        ring of large blocks, which hands over the end of a frame when the block is full, or 5 ms are over
        (`tp_retire_blk_tov` in arvgvstream.c of Aravis 0.8).
        """
        kept = receive_buffer(self._camera.get_payload())
        if kept is not None:
            self._camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        stream = self._camera.create_stream(None, None)
        if kept is None:
            stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.AUTO)
        else:
            stream.set_property("socket-buffer-size", kept)
            stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        return stream

    def _read_back(self) -> dict[str, str]:
        camera, region = self._camera, self._camera.get_region()
        facts = {
            "camera": self.name,
            "pixel format": str(self._format),
            "region": f"{region.width} × {region.height} at ({region.x}, {region.y})",
            "exposure": f"{1e3 * self.exposure_s:.4g} ms",
        }
        if camera.is_gain_available():
            facts["gain"] = f"{camera.get_gain():g}"
        if camera.is_binning_available():
            binning = camera.get_binning()
            facts["binning"] = f"{binning.dx} × {binning.dy}"
        if camera.is_gv_device():
            facts["address"] = camera.get_device().get_device_address().get_address().to_string()
            facts["packet size"] = f"{camera.gv_get_packet_size()} bytes"
        return facts

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
        """Compare the camera's clock minus ours with what it usually is: a trigger that was obeyed late may have
        exposed the next picture. Clocks drift and are set, which the median of the last frames follows.
        """
        offsets_s = self._offsets_s[self.exposure_s]
        usual_s = median(offsets_s) if offsets_s else offset_s
        offsets_s.append(offset_s)
        self.late_s = offset_s - min(offsets_s)
        if offset_s - usual_s > TRIGGER_LAG_S:
            raise FrameLostError(f"exposed {1e3 * (offset_s - usual_s):.0f} ms late")

    def _pop(self, timeout_s: float) -> Any | None:
        """The next buffer, whatever its status; None if the time is over. Answers Ctrl-C."""
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
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(buffer)

    def _run_dry(self) -> None:
        """Wait until nothing has arrived for a while: a repeated trigger may have exposed frames that nobody wants."""
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


def _came_s(buffer: Any) -> float:
    """When the first packet of a frame came (monotonic clock)."""
    return float(buffer.get_system_timestamp() / 1e9 - time.time() + time.monotonic())


def _centred(room: int, step: int) -> int:
    return room // 2 // step * step


def _serial(camera: Any) -> str:
    return str(camera.get_device_serial_number())


def _open(wanted: str | None) -> Any:
    """The camera of that id, serial number or address; without any, the only one."""
    if wanted is None:
        found = _discover()
        if len(found) != 1:
            raise DeviceError(not_found("expected one camera, as the rig names none", found))
        wanted = found[0].device_id
    try:
        return Aravis.Camera.new(wanted)
    except GLib.Error as error:
        raise DeviceError(not_found(f"no camera answers to {wanted!r} ({error.message})", _discover())) from error
