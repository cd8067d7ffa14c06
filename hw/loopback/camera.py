"""A GigE Vision camera on the network: Aravis' simulated camera, with images of our own.

It is driven through ctypes, because its image callback crashes through PyGObject. The simulator has one thread for
commands, frames and this callback. During an exposure it therefore does not answer, but for less than a client's
timeout.
"""

import ctypes
import ctypes.util
import socket
from collections.abc import Callable
from typing import Self

from hw.errors import DeviceError
from hw.loopback.exposure import ExposureRequest

# Registers of Aravis' simulated camera (arvfakecamera.h, 0.8).
_WIDTH, _HEIGHT, _SENSOR_HEIGHT, _SENSOR_WIDTH, _OFFSET_X, _OFFSET_Y = 0x100, 0x104, 0x118, 0x11C, 0x130, 0x134
_GVCP_PORT = 3956
_POLL_HZ = 500.0  # how often the simulator looks for a trigger
_LIBRARIES = ("libaravis-0.8.so.0", "libgobject-2.0.so.0")

_Fill = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)


class LoopbackCamera:
    """A camera that answers at an address of this machine while the `with` block runs.

    `expose` is called for every frame, in the simulator's thread. Raises DeviceError if Aravis is not installed or
    the address is taken.
    """

    def __init__(
        self,
        address: str,
        serial: str,
        size: tuple[int, int],
        expose: Callable[[ExposureRequest], bytes],
    ) -> None:
        self._aravis, self._gobject = _libraries()
        self._address, self._serial, self._size = address, serial, size
        self._expose = expose
        self._fill = _Fill(self._filled)  # must live as long as the simulator

    def __enter__(self) -> Self:
        _refuse_taken(self._address)
        aravis = self._aravis
        self._server = aravis.arv_gv_fake_camera_new(self._address.encode(), self._serial.encode())
        self._camera = aravis.arv_gv_fake_camera_get_fake_camera(self._server)
        if not aravis.arv_gv_fake_camera_is_running(self._server):
            raise DeviceError(f"loopback camera: cannot be served at {self._address}")
        for register, value in zip((_SENSOR_WIDTH, _SENSOR_HEIGHT, _WIDTH, _HEIGHT), self._size * 2, strict=True):
            aravis.arv_fake_camera_write_register(self._camera, register, value)
        aravis.arv_fake_camera_set_trigger_frequency(self._camera, _POLL_HZ)
        aravis.arv_fake_camera_set_fill_pattern(self._camera, self._fill, None, None)
        return self

    def __exit__(self, *_: object) -> None:
        self._gobject.g_object_unref(self._server)

    def lose(self, share: float) -> None:
        """Do not send this share of the stream's packets from now on."""
        self._gobject.g_object_set(self._server, b"gvsp-lost-ratio", share, None)

    def _filled(self, buffer: int, _: object, exposure_us: int, gain: int, pixel_format: int) -> None:
        region = (self._register(_OFFSET_X), self._register(_OFFSET_Y), self._register(_WIDTH), self._register(_HEIGHT))
        data = self._expose(ExposureRequest(exposure_us, gain, pixel_format, region))
        # The buffer reports size 0 here, but it was allocated for width × height × bytes of a pixel.
        ctypes.memmove(self._aravis.arv_buffer_get_data(buffer, None), data, len(data))

    def _register(self, address: int) -> int:
        value = ctypes.c_uint32()
        self._aravis.arv_fake_camera_read_register(self._camera, address, ctypes.byref(value))
        return value.value


def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    try:
        aravis, gobject = (ctypes.CDLL(name) for name in _LIBRARIES)
    except OSError as error:
        raise DeviceError(f"loopback camera: {error}. Install it: apt-get install gir1.2-aravis-0.8") from error
    pointer, text, number = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_uint32
    for function, result, arguments in (
        (aravis.arv_gv_fake_camera_new, pointer, (text, text)),
        (aravis.arv_gv_fake_camera_get_fake_camera, pointer, (pointer,)),
        (aravis.arv_gv_fake_camera_is_running, ctypes.c_int, (pointer,)),
        (aravis.arv_fake_camera_write_register, ctypes.c_int, (pointer, number, number)),
        (aravis.arv_fake_camera_read_register, ctypes.c_int, (pointer, number, ctypes.POINTER(number))),
        (aravis.arv_fake_camera_set_trigger_frequency, None, (pointer, ctypes.c_double)),
        (aravis.arv_fake_camera_set_fill_pattern, None, (pointer, _Fill, pointer, pointer)),
        (aravis.arv_buffer_get_data, pointer, (pointer, pointer)),
        (gobject.g_object_set, None, (pointer, text, ctypes.c_double, pointer)),
        (gobject.g_object_unref, None, (pointer,)),
    ):
        function.restype, function.argtypes = result, arguments
    return aravis, gobject


def _refuse_taken(address: str) -> None:
    """Raise DeviceError if the port is taken: two simulators would share it and answer alternately."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, _GVCP_PORT))
        except OSError as error:
            raise DeviceError(f"loopback camera: {address} port {_GVCP_PORT}: {error.strerror}") from error
