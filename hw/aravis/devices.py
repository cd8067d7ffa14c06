"""What cameras Aravis finds on the network and at USB, and opening one; the only file that imports gi."""

from dataclasses import replace
from typing import Any

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402  # only after the version is chosen

from hw.cameras import CameraInfo, not_found  # noqa: E402
from hw.errors import DeviceError  # noqa: E402

__all__ = ["Aravis", "GLib", "list_cameras", "open_camera"]


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


def open_camera(wanted: str | None) -> Any:
    """The camera of that id, serial number or address; without any, the only one. Raises DeviceError."""
    if wanted is None:
        found = _discover()
        if len(found) != 1:
            raise DeviceError(not_found("expected one camera, as the rig names none", found))
        wanted = found[0].device_id
    try:
        return Aravis.Camera.new(wanted)
    except GLib.Error as error:
        raise DeviceError(not_found(f"no camera answers to {wanted!r} ({error.message})", _discover())) from error
