"""Lists and opens the cameras that Aravis finds on the network and USB. The only file that imports gi."""

from dataclasses import dataclass
from typing import Any

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402  # only after the version is chosen

from hw.cameras import CameraInfo, not_found  # noqa: E402
from hw.errors import DeviceError  # noqa: E402

__all__ = ["Aravis", "GLib", "list_cameras", "open_camera"]

_PREFERRED_FORMATS = ("Mono8", "BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8")


@dataclass(frozen=True)
class _Found:
    """A camera that answers."""

    device_id: str
    vendor: str
    model: str
    serial: str
    address: str

    def __str__(self) -> str:
        return f"{self.vendor} {self.model} {self.serial} at {self.address}"


def list_cameras() -> list[CameraInfo]:
    """All cameras that answer; sensor size and formats if no other program uses them. Takes seconds."""
    return [_with_abilities(device) for device in _discover()]


def _discover() -> list[_Found]:
    Aravis.update_device_list()
    return [
        _Found(
            Aravis.get_device_id(index),
            Aravis.get_device_vendor(index) or "",
            Aravis.get_device_model(index) or "",
            Aravis.get_device_serial_nbr(index) or "",
            Aravis.get_device_address(index) or "",
        )
        for index in range(Aravis.get_n_devices())
    ]


def _with_abilities(device: _Found) -> CameraInfo:
    try:
        camera = Aravis.Camera.new(device.device_id)
        size = camera.get_sensor_size()
        formats = tuple(camera.dup_available_pixel_formats_as_strings())
    except GLib.Error:  # found, but in use or not reachable
        return CameraInfo(str(device), "in use by another program, or unreachable: its capabilities are unknown")
    pixel_format = next((name for name in (*_PREFERRED_FORMATS, *formats) if name in formats), "Mono8")
    return CameraInfo(
        str(device),
        f"sensor {size.width} × {size.height}, formats {', '.join(formats)}",
        ("backend: aravis", f'camera: "{device.device_id}"', f"pixel_format: {pixel_format}"),
        (size.width, size.height),
    )


def open_camera(wanted: str | None) -> Any:
    """Open the camera with this id, serial number or address; with None, the only one. Raises DeviceError."""
    if wanted is None:
        devices = _discover()
        if len(devices) != 1:
            raise DeviceError(not_found("expected one camera, as the rig names none", [*map(str, devices)]))
        wanted = devices[0].device_id
    try:
        return Aravis.Camera.new(wanted)
    except GLib.Error as error:
        there = [*map(str, _discover())]
        raise DeviceError(not_found(f"no camera answers to {wanted!r} ({error.message})", there)) from error
