"""Tethered photo cameras (DSLR, mirrorless) through python-gphoto2, triggered one frame at a time.

Written to libgphoto2's documentation and python-gphoto2's interface. Tested with a fake of that interface only, never
with a real camera.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from math import inf
from types import ModuleType
from typing import Any, ClassVar, Literal

import cv2
import numpy as np
from pydantic import Field

from calib.numerics import Image
from hw.cameras import CameraInfo, not_found, refuse_other_setting, refuse_other_size
from hw.errors import DeviceError, FrameLostError
from hw.jpeg import is_whole_jpeg
from hw.optional_parts import GPHOTO2
from hw.rig import Capabilities, Frame
from hw.settings import USUAL_EXPOSURE_US, CameraRigSettings
from hw.timing.devices import nothing, whole_periods

# Makers have different names for the same setting.
_SHUTTER, _ISO, _APERTURE = ("shutterspeed", "shutterspeed2"), ("iso",), ("aperture", "f-number")
_FORMAT, _MODE, _BATTERY = ("imageformat", "imagequality"), ("autoexposuremode", "expprogram"), ("batterylevel",)
_FOCUS, _TARGET = ("focusmode",), ("capturetarget",)
_IN_MEMORY = ("Internal RAM", "sdram")  # frames need no card there
_RAW = ("raw", "nef")
_CARD_ADVICE = "Put in a card with room, unlocked, or empty this one."
_ADVICE = {
    "GP_ERROR_IO_USB_CLAIM": "Another program has it: close it, or unmount the camera in the file manager.",
    "GP_ERROR_MODEL_NOT_FOUND": "Switch it on, and check its cable; scan devices lists what answers.",
    "GP_ERROR_NO_SPACE": f"Its card is full. {_CARD_ADVICE}",
    "GP_ERROR_CAMERA_BUSY": "Put it to manual focus and wait until it has written its pictures.",
    "GP_ERROR_CAMERA_ERROR": f"Look at its display: card, battery, focus. {_CARD_ADVICE}",
}


class GPhotoRigSettings(CameraRigSettings):
    """A tethered photo camera reached through gphoto2, and a projector that is a screen."""

    slow: ClassVar[bool] = True

    backend: Literal["gphoto2"]
    camera: str | None = Field(
        None, min_length=1, description="Model or port as `scan devices` lists them; default: the only camera."
    )
    exposure_us: float = Field(
        USUAL_EXPOSURE_US,
        gt=0.0,
        le=30_000_000.0,
        description="Exposure; the shutter speed nearest to whole refresh periods is taken.",
    )
    gain: None = Field(None, description="Not for these cameras: they have iso.")
    iso: str | None = Field(
        None, coerce_numbers_to_str=True, description="One of the camera's ISO values; default: unchanged."
    )
    aperture: str | None = Field(
        None, coerce_numbers_to_str=True, description="One of the camera's f-numbers; default: unchanged."
    )
    format: Literal["jpeg", "raw"] = Field("jpeg", description="What the camera sends; raw frames are linear, 16 bit.")

    @property
    def has_gain(self) -> bool:
        """Photo cameras have `iso` instead."""
        return False

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes per pixel of a colour frame."""
        return 3 if self.format == "jpeg" else 6


def load() -> ModuleType:
    """This module. Raises DeviceError, naming what to install, if gphoto2 is missing."""
    _library()
    return sys.modules[__name__]


def _library() -> Any:
    with GPHOTO2.needed("a photo camera", "gphoto2", DeviceError):
        import gphoto2  # only now, for most users have none
    return gphoto2


def list_cameras() -> list[CameraInfo]:
    """Photo cameras that answer."""
    return [
        CameraInfo(model, f"photo camera at {port}", ("backend: gphoto2", f'camera: "{model}"'))
        for model, port in _there(_library())
    ]


def _there(gp: Any) -> list[tuple[str, str]]:
    """Models and ports."""
    try:
        cameras = gp.Camera.autodetect()
        return [(str(cameras.get_name(index)), str(cameras.get_value(index))) for index in range(cameras.count())]
    except gp.GPhoto2Error as error:
        raise DeviceError(f"searching for photo cameras failed: {error.string}") from error


def connect(settings: GPhotoRigSettings, size: tuple[int, int], refresh_hz: float) -> "GPhotoCamera":
    """Open the camera of these settings. Raises DeviceError."""
    return GPhotoCamera(settings, size, refresh_hz)


class GPhotoCamera(AbstractContextManager["GPhotoCamera"]):
    """A camera from opening to closing (a context manager), with exposures triggered one at a time.

    The delay from trigger to exposure is unknown; it is only known when the exposure is over. Raises DeviceError if
    there is no such camera, or if it does not accept a setting.
    """

    late_s = 0.0
    wait_s = inf
    capabilities = Capabilities(exposure="settable")

    def __init__(self, settings: GPhotoRigSettings, size: tuple[int, int], refresh_hz: float) -> None:
        self.size = size
        self.name = settings.camera or "that was found"
        self._gp = _library()
        self._raw = settings.format == "raw"
        self._refresh_hz = refresh_hz
        self._path: Any = None
        self.highest_level = 65535 if self._raw else 255
        self.name, port = self._found(settings.camera)
        self._camera = self._gp.Camera()
        with self._errors("cannot be opened"):
            self._camera.set_port_info(_port_info(self._gp, port))
            self._camera.init()
        try:
            self.identity = {"camera": self.name, "format": settings.format}
            self._configure(settings)
        except BaseException:
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def exposure_us(self) -> float:
        """The exposure in microseconds, as read back from the camera."""
        return 1e6 * self.exposure_s

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """The shortest and the longest shutter speed in microseconds."""
        seconds = self._shutter_speeds.values()
        return 1e6 * min(seconds), 1e6 * max(seconds)

    def expose_for(self, exposure_us: float) -> float:
        """Choose the shutter speed nearest to whole refresh periods; returns it in µs. Raises DeviceError."""
        wanted_s = whole_periods(exposure_us, self._refresh_hz)[0] / 1e6
        choice = min(self._shutter_speeds, key=lambda name: abs(np.log(self._shutter_speeds[name] / wanted_s)))
        self._set(_SHUTTER, choice)
        self.exposure_s = self._shutter_speeds[choice]
        return self.exposure_us

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose one frame, and wait until that is over; returns the time of the trigger. Raises DeviceError."""
        meanwhile()
        triggered_s = time.monotonic()
        with self._errors("does not take a picture"):
            self._path = self._camera.capture(self._gp.GP_CAPTURE_IMAGE)
        return triggered_s

    def collect(self) -> Frame:
        """The last exposed frame, which is then deleted in the camera. Raises FrameLostError, DeviceError."""
        path = self._path
        with self._errors("does not send its picture"):
            data = self._camera.file_get(path.folder, path.name, self._gp.GP_FILE_TYPE_NORMAL).get_data_and_size()
            content = bytes(memoryview(data))
            self._camera.file_delete(path.folder, path.name)
        return Frame(self._image(content, path.name), exposure_us=self.exposure_us)

    def grab(self) -> Frame:
        """Expose and collect."""
        self.expose()
        return self.collect()

    def close(self) -> None:
        """Release the camera."""
        with suppress(self._gp.GPhoto2Error):  # it may be gone by now
            self._camera.exit()

    def _image(self, content: bytes, name: str) -> Image:
        image = _developed(content) if self._raw else _decoded(content)
        if image is None:
            kind = "raw" if self._raw else "jpeg"
            raise FrameLostError(f"{name}, {len(content):,} bytes, is not a whole image of the format {kind}")
        refuse_other_size(self.name, self.size, (image.shape[1], image.shape[0]))
        return np.asarray(image)

    def _found(self, wanted: str | None) -> tuple[str, str]:
        """Model and port."""
        there = _there(self._gp)
        chosen = [name for name in there if wanted is None or wanted in name]
        if len(chosen) != 1:
            problem = "expected one photo camera" if wanted is None else f"no single photo camera is called {wanted!r}"
            raise DeviceError(not_found(problem, [f"{model} at {port}" for model, port in there]))
        return chosen[0]

    def _configure(self, settings: GPhotoRigSettings) -> None:
        mode, battery = self._get(_MODE), self._get(_BATTERY)
        if mode is not None and not mode.lower().startswith("m"):
            raise DeviceError(f"camera {self.name}: its mode is {mode}. Turn its dial to M (manual), then rerun.")
        if battery is not None and battery.strip(" %").isdigit() and int(battery.strip(" %")) < 10:
            raise DeviceError(f"camera {self.name}: its battery is at {battery}. Charge it or use mains, then rerun.")
        self._set_if_there(_TARGET, _IN_MEMORY)
        self._set_if_there(_FOCUS, ("Manual", "MF"))
        for kind, wanted in (("iso", settings.iso), ("aperture", settings.aperture)):
            names = _ISO if kind == "iso" else _APERTURE
            if wanted is not None:
                self._set(names, wanted)
            self.identity[kind] = self._get(names) or "unknown"
        self._choose_format()
        self._shutter_speeds = {name: s for name in self._choices(_SHUTTER) if (s := _seconds(name)) is not None}
        if not self._shutter_speeds:
            raise DeviceError(f"camera {self.name}: its shutter speed cannot be set. Turn its dial to M, then rerun.")
        self.expose_for(settings.exposure_us)
        self.identity["exposure"] = f"{1e3 * self.exposure_s:.4g} ms"

    def _choose_format(self) -> None:
        """Unless the camera already sends JPEG or RAW as wanted, choose its first format that is only that."""
        now = self._get(_FORMAT)
        if now is None or _is_raw(now) == self._raw:
            return
        fitting = [name for name in self._choices(_FORMAT) if _is_raw(name) == self._raw and "+" not in name]
        if not fitting:
            raise DeviceError(f"camera {self.name}: it sends {now} and offers nothing else. Choose it in its menu.")
        self._set(_FORMAT, fitting[0])

    def _widget(self, names: Sequence[str]) -> tuple[Any, Any] | None:
        """The camera's configuration, and its widget with the first of these names that exists; None if none does."""
        with self._errors("does not list its settings"):
            config = self._camera.get_config()
        for name in names:
            with suppress(self._gp.GPhoto2Error):
                return config, config.get_child_by_name(name)
        return None

    def _get(self, names: Sequence[str]) -> str | None:
        widget = self._widget(names)
        return None if widget is None else str(widget[1].get_value())

    def _choices(self, names: Sequence[str]) -> list[str]:
        widget = self._widget(names)
        return [] if widget is None else [str(choice) for choice in widget[1].get_choices()]

    def _set(self, names: Sequence[str], value: str) -> None:
        """Set a value and read it back. Raises DeviceError if the camera sets another one."""
        setting = self._widget(names)
        if setting is None:
            raise DeviceError(f"camera {self.name}: it has no setting {names[0]}. Set it in the camera's menu.")
        config, widget = setting
        if (choices := [str(choice) for choice in widget.get_choices()]) and value not in choices:
            raise DeviceError(
                f"camera {self.name}: {names[0]} {value!r} is not available; it offers {', '.join(choices)}."
            )
        with self._errors(f"does not take {value!r} as {names[0]}"):
            widget.set_value(value)
            self._camera.set_config(config)
        refuse_other_setting(self.name, names[0], value, self._get(names))

    def _set_if_there(self, names: Sequence[str], wanted: Sequence[str]) -> None:
        value = next((name for name in self._choices(names) if name in wanted), None)
        if value is not None:
            self._set(names, value)

    @contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        try:
            yield
        except self._gp.GPhoto2Error as error:
            advice = {getattr(self._gp, name): text for name, text in _ADVICE.items()}
            usual = "Check that it is on, its battery, card and cable."
            raise DeviceError(
                f"camera {self.name}: {what} ({error.string}). {advice.get(error.code, usual)} Then rerun."
            ) from error


def _port_info(gp: Any, port: str) -> Any:
    ports = gp.PortInfoList()
    ports.load()
    return ports[ports.lookup_path(port)]


def _is_raw(name: str) -> bool:
    return any(part in name.lower() for part in _RAW)


def _seconds(shutter_speed: str) -> float | None:
    """Seconds of a shutter speed such as '1/30', '0.5' or '2s'; None for 'bulb' and the like."""
    over, _, under = shutter_speed.lower().removesuffix("s").partition("/")
    try:
        return float(over) / float(under or 1) or None
    except (ValueError, ZeroDivisionError):
        return None


def _decoded(content: bytes) -> Any:
    """The image of a JPEG file, (H, W, 3) in BGR; None if it is empty, cut off, or cannot be decoded."""
    if not is_whole_jpeg(content):
        return None
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:  # a header of absurd sizes
        return None


def _developed(content: bytes) -> Any:
    """The image of a RAW file, (H, W, 3) in BGR, 16 bit and linear; None if it cannot be decoded."""
    with GPHOTO2.needed("a RAW frame", "rawpy", DeviceError):
        import rawpy  # only now, for few need it
    from io import BytesIO

    try:
        with rawpy.imread(BytesIO(content)) as raw:
            rgb = raw.postprocess(gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True, user_flip=0)
    except rawpy.LibRawError:
        return None
    return np.ascontiguousarray(rgb[:, :, ::-1])
