"""A GigE Vision camera on the network: Aravis' simulated camera, with images of our own.

It is driven through ctypes, because its image callback crashes through PyGObject. The simulator has one thread for
commands, frames and this callback. During an exposure it therefore does not answer, but for less than a client's
timeout.

One exposure of the simulated room: the sensor integrates the light of all pictures that fall into it.
"""

import ctypes
import ctypes.util
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from calib.numerics import Image
from hw.errors import DeviceError
from hw.loopback.screen import ScreenLight
from hw.loopback.settings import LoopbackSettings
from hw.simulated import Light, Sensor, SimulatedRoom

# GenICam's numbers of the pixel formats that Aravis' simulator offers (PFNC 2.4).
MONO_8, MONO_16, RGB_8 = 0x01080001, 0x01100007, 0x02180014
_MOSAICS = {0x01080008: "GRBG", 0x01080009: "RGGB", 0x0108000A: "GBRG", 0x0108000B: "BGGR"}
# Transmission of the sensor's colour filters for the projector's white.
_THROUGH_FILTER = {"R": 0.7, "G": 1.0, "B": 0.6}
_DECIBELS_PER_FACTOR_TEN = 20.0
# Registers of Aravis' simulated camera (arvfakecamera.h, 0.8).
_WIDTH, _HEIGHT, _SENSOR_HEIGHT, _SENSOR_WIDTH, _OFFSET_X, _OFFSET_Y = 0x100, 0x104, 0x118, 0x11C, 0x130, 0x134
_GVCP_PORT = 3956
_POLL_HZ = 500.0  # how often the simulator looks for a trigger
_LIBRARIES = ("libaravis-0.8.so.0", "libgobject-2.0.so.0")

_Fill = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)


@dataclass(frozen=True)
class ExposureRequest:
    """The camera's registers at the trigger; `region` is (x, y, width, height) in pixels."""

    exposure_us: float
    gain_db: float
    pixel_format: int
    region: tuple[int, int, int, int]


class RoomSensor:
    """Exposes frames of a simulated room that a screen lights.

    The aperture is set so that white reaches 85 % of the range at `white_exposure_us`, without gain. `screen` renders
    pictures to expected electrons (H, W) of such an exposure.
    """

    def __init__(self, room: SimulatedRoom, screen: ScreenLight, white_exposure_us: float) -> None:
        self._sensor = room.sensor
        self._screen = screen
        self._white_exposure_us = white_exposure_us
        self._rng = np.random.default_rng()

    def expose(self, request: ExposureRequest) -> bytes:
        """Expose from now on, in real time, and return the frame's bytes as the camera sends them."""
        begin_s = time.monotonic()
        exposure_s = request.exposure_us / 1e6
        self._screen.look()
        x, y, width, height = request.region
        channels = 3 if request.pixel_format == RGB_8 else 1
        noise = list(self._rng.standard_normal((channels, height, width), np.float32))
        # Compute during the exposure: a real sensor has its frame when the exposure ends.
        time.sleep(max(0.0, self._screen.decided_s(begin_s + exposure_s) - time.monotonic()))
        self._screen.look()
        part = np.s_[y : y + height, x : x + width]
        electrons = np.zeros((height, width), np.float32)
        for share, light in self._screen.shares(begin_s, begin_s + exposure_s):
            electrons += np.float32(share * request.exposure_us / self._white_exposure_us) * light[part]
        digits = self._digits(electrons, noise, request)
        time.sleep(max(0.0, begin_s + exposure_s - time.monotonic()))
        return digits

    def _digits(self, electrons: Light, noise: list[Light], request: ExposureRequest) -> bytes:
        sensor = self._amplified(16 if request.pixel_format == MONO_16 else 8, request.gain_db)
        if request.pixel_format in _MOSAICS:
            electrons = electrons * _mosaic(_MOSAICS[request.pixel_format], electrons.shape)
        if request.pixel_format == RGB_8:
            filtered = [electrons * np.float32(_THROUGH_FILTER[name]) for name in "RGB"]
            channels = [sensor.read_with(*channel_and_noise) for channel_and_noise in zip(filtered, noise, strict=True)]
            return np.asarray(cv2.merge(channels)).tobytes()
        return sensor.read_with(electrons, noise[0]).tobytes()

    def _amplified(self, bits: int, gain_db: float) -> Sensor:
        """The sensor with gain: fewer electrons saturate it."""
        sensor = self._sensor
        full_well = sensor.full_well_electrons / 10 ** (gain_db / _DECIBELS_PER_FACTOR_TEN)
        return Sensor(sensor.blur_px, sensor.exposure_us, bits, full_well, sensor.read_noise_electrons)


def _mosaic(order: str, shape: tuple[int, ...]) -> Light:
    tile = np.array([_THROUGH_FILTER[name] for name in order], np.float32).reshape(2, 2)
    return np.tile(tile, (-(-shape[0] // 2), -(-shape[1] // 2)))[: shape[0], : shape[1]]


class LitRoom:
    """The room of a loopback camera, with a projector for each screen of these sizes, (width, height) in pixels.

    `brightest`: the room as the brightest projector alone lights it. The camera's sensor is set for that one.
    """

    def __init__(self, settings: LoopbackSettings, screens: Sequence[tuple[int, int]]) -> None:
        poses = settings.projector_poses or (settings.room.projector_pose,)
        self._rooms = [
            SimulatedRoom(settings.room.model_copy(update={"projector_pose": pose}), settings.camera_size, size)
            for pose, size in zip(poses, screens, strict=True)
        ]
        self.brightest = min(self._rooms, key=lambda room: room.sensor.exposure_us)

    def electrons(self, number: int, picture: Image) -> Light:
        """Expected electrons (H, W) while the projector of that number shows an 8-bit picture; those of all projectors
        add up. The first projector's are with the ambient light.
        """
        renderer = self._rooms[number].renderer
        light = renderer.projected(renderer.picture.linear(picture))
        return self.brightest.sensor.electrons(light if number else light + renderer.ambient)


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
