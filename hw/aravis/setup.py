"""Configures a GenICam camera through Aravis, and reads the settings back. A different value is an error.

Observed with Aravis 0.8, and relied on here: it clips an impossible setting silently unless ranges are checked.
`camera` is an Aravis.Camera throughout, `name` what errors call it. GLib.Error is raised if it does not answer.
"""

from pathlib import Path
from typing import Any

from hw.aravis.devices import Aravis
from hw.aravis.pixel_formats import PixelFormat, pixel_format
from hw.aravis.settings import AravisRigSettings
from hw.cameras import refuse_other_setting

_LIMIT = Path("/proc/sys/net/core/rmem_max")
# The kernel counts overhead of packets too, and the reader may be late.
_KEPT = 4


def receive_buffer(frame_bytes: int, limit: Path = _LIMIT) -> int | None:
    """Bytes of a receive buffer that holds a whole frame with reserve; None if the system's limit is lower."""
    wanted = _KEPT * frame_bytes
    try:
        return wanted if int(limit.read_text()) >= wanted else None
    except (OSError, ValueError):  # not Linux, or not readable
        return None


_BUFFERS = 4
_AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")


def configure(
    camera: Any, name: str, settings: AravisRigSettings, size: tuple[int, int], exposure_us: float
) -> PixelFormat:
    """Make all settings and switch automatics off; `size` is (width, height) of the frames. Raises DeviceError."""
    camera.set_range_check_policy(Aravis.RangeCheckPolicy.ENABLE)
    camera.set_acquisition_mode(Aravis.AcquisitionMode.CONTINUOUS)
    if settings.binning > 1 or camera.is_binning_available():
        camera.set_binning(settings.binning, settings.binning)
    camera.set_pixel_format_from_string(settings.pixel_format)
    _set_region(camera, name, size, settings.offset_px)
    for feature in _AUTOMATICS:
        if camera.is_feature_available(feature):
            camera.set_string(feature, "Off")
    if camera.is_feature_available("GammaEnable"):
        camera.set_boolean("GammaEnable", False)
    camera.set_exposure_time(exposure_us)
    refuse_other_setting(name, "exposure in µs", exposure_us, camera.get_exposure_time())
    if settings.gain is not None:
        camera.set_gain(settings.gain)
        refuse_other_setting(name, "gain", settings.gain, camera.get_gain())
    if settings.trigger == "free-run":
        camera.clear_triggers()
    else:
        camera.set_trigger("Software" if settings.trigger == "software" else settings.trigger_line)
    return pixel_format(camera.get_pixel_format_as_string())


def _set_region(camera: Any, name: str, size: tuple[int, int], offset_px: tuple[int, int] | None) -> None:
    """Set the region of interest, in the middle of the sensor by default."""
    width, height = size
    camera.set_region(0, 0, width, height)
    if offset_px is None:
        room = (camera.get_width_bounds().max - width, camera.get_height_bounds().max - height)
        steps = (camera.get_x_offset_increment(), camera.get_y_offset_increment())
        offset_px = (_centred(room[0], steps[0]), _centred(room[1], steps[1]))
    if offset_px != (0, 0):
        camera.set_region(*offset_px, width, height)
    region = camera.get_region()
    refuse_other_setting(name, "width in pixels", width, region.width)
    refuse_other_setting(name, "height in pixels", height, region.height)


def start(camera: Any, name: str, settings: AravisRigSettings) -> Any:
    """Start the acquisition; returns the stream of frames. Raises DeviceError."""
    if camera.is_gv_device():
        if settings.packet_size is None:
            camera.gv_auto_packet_size()
        else:
            camera.gv_set_packet_size(settings.packet_size)
            refuse_other_setting(name, "packet size", settings.packet_size, camera.gv_get_packet_size())
        stream = _network_stream(camera)
    else:
        stream = camera.create_stream(None, None)
    for _ in range(_BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
    camera.start_acquisition()
    return stream


def _network_stream(camera: Any) -> Any:
    """A stream through a plain socket, if its buffer holds whole frames.

    By default Aravis uses a packet socket if it may (as root). Its ring of large blocks delivers the end of a frame
    only when a block is full or after 5 ms (`tp_retire_blk_tov` in arvgvstream.c of Aravis 0.8).
    """
    kept = receive_buffer(camera.get_payload())
    if kept is not None:
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
    stream = camera.create_stream(None, None)
    if kept is None:
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.AUTO)
    else:
        stream.set_property("socket-buffer-size", kept)
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
    return stream


def read_back(camera: Any, name: str) -> dict[str, str]:
    """The camera's settings as read back, for the recording's metadata."""
    region = camera.get_region()
    settings_read = {
        "camera": name,
        "pixel format": camera.get_pixel_format_as_string(),
        "region": f"{region.width} × {region.height} at ({region.x}, {region.y})",
        "exposure": f"{1e-3 * camera.get_exposure_time():.4g} ms",
    }
    if camera.is_gain_available():
        settings_read["gain"] = f"{camera.get_gain():g}"
    if camera.is_binning_available():
        binning = camera.get_binning()
        settings_read["binning"] = f"{binning.dx} × {binning.dy}"
    if camera.is_gv_device():
        settings_read["address"] = camera.get_device().get_device_address().get_address().to_string()
        settings_read["packet size"] = f"{camera.gv_get_packet_size()} bytes"
    return settings_read


def _centred(room: int, step: int) -> int:
    return room // 2 // step * step
