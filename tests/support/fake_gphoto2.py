"""python-gphoto2's interface, with a camera that photographs what a mirror shows."""

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

GP_CAPTURE_IMAGE = 0
GP_FILE_TYPE_NORMAL = 1
GP_ERROR_IO_USB_CLAIM, GP_ERROR_MODEL_NOT_FOUND, GP_ERROR_NO_SPACE = -53, -105, -115
GP_ERROR_CAMERA_BUSY, GP_ERROR_CAMERA_ERROR = -110, -113
GP_ERROR_BAD_PARAMETERS = -2

SHUTTER_SPEEDS = ["bulb", "2", "0.5", "1/15", "1/30", "1/60", "1/125"]


class GPhoto2Error(Exception):
    def __init__(self, code: int, text: str = "Unspecified error") -> None:
        super().__init__(f"[{code}] {text}")
        self.code = code
        self.string = text


@dataclass
class Device:
    """Properties of the fake camera, which tests change."""

    see: Callable[[], np.ndarray]
    model: str = "Canon EOS 700D"
    settings: dict[str, tuple[str, list[str]]] = field(
        default_factory=lambda: {
            "shutterspeed": ("1/125", SHUTTER_SPEEDS),
            "iso": ("100", ["100", "200", "400"]),
            "aperture": ("5.6", ["5.6", "8", "11"]),
            "imageformat": ("RAW", ["Large Fine JPEG", "RAW", "RAW + Large Fine JPEG"]),
            "capturetarget": ("Memory card", ["Internal RAM", "Memory card"]),
            "autoexposuremode": ("Manual", []),
            "batterylevel": ("75%", []),
        }
    )
    spoil: Callable[[int, bytes], bytes] = lambda number, content: content  # of each file, counted from 1
    fails: dict[str, GPhoto2Error] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    taken: int = 0
    open: bool = False

    def check(self, call: str) -> None:
        if call in self.fails:
            raise self.fails[call]


device = Device(lambda: np.zeros((1, 1, 3), np.uint8))


class _List:
    def __init__(self, rows: list[tuple[str, str]]) -> None:
        self._rows = rows

    def count(self) -> int:
        return len(self._rows)

    def get_name(self, index: int) -> str:
        return self._rows[index][0]

    def get_value(self, index: int) -> str:
        return self._rows[index][1]


class PortInfoList:
    def load(self) -> None:
        pass

    def lookup_path(self, path: str) -> int:
        return 0 if path == "usb:001,005" else -1

    def __getitem__(self, index: int) -> str:
        if index < 0:
            raise GPhoto2Error(GP_ERROR_BAD_PARAMETERS)
        return "usb:001,005"


class CameraWidget:
    def __init__(self, values: dict[str, str], name: str = "") -> None:
        self._values, self._name = values, name

    def get_child_by_name(self, name: str) -> "CameraWidget":
        if name not in self._values:
            raise GPhoto2Error(GP_ERROR_BAD_PARAMETERS, "Bad parameters")
        return CameraWidget(self._values, name)

    def get_value(self) -> str:
        return self._values[self._name]

    def set_value(self, value: str) -> None:
        self._values[self._name] = value

    def get_choices(self) -> list[str]:
        return device.settings[self._name][1]

    @property
    def values(self) -> dict[str, str]:
        return self._values


@dataclass(frozen=True)
class CameraFilePath:
    folder: str
    name: str


class CameraFile:
    def __init__(self, content: bytes) -> None:
        self._content = content

    def get_data_and_size(self) -> memoryview:
        return memoryview(self._content)


class Camera:
    @staticmethod
    def autodetect() -> _List:
        device.check("autodetect")
        return _List([(device.model, "usb:001,005")] if device.model else [])

    def set_port_info(self, info: str) -> None:
        assert info == "usb:001,005"

    def init(self) -> None:
        device.check("init")
        device.open = True

    def exit(self) -> None:
        device.open = False

    def get_config(self) -> CameraWidget:
        return CameraWidget({name: value for name, (value, _) in device.settings.items()})

    def set_config(self, config: CameraWidget) -> None:
        device.check("set_config")
        for name, value in config.values.items():
            device.settings[name] = value, device.settings[name][1]

    def capture(self, kind: int) -> CameraFilePath:
        assert kind == GP_CAPTURE_IMAGE
        device.check("capture")
        device.taken += 1
        name = f"IMG_{device.taken:04d}.JPG"
        jpeg = bytes(cv2.imencode(".jpg", device.see(), [cv2.IMWRITE_JPEG_QUALITY, 97])[1])
        device.files[name] = device.spoil(device.taken, jpeg)
        return CameraFilePath("/store_00010001", name)

    def file_get(self, folder: str, name: str, kind: int) -> CameraFile:
        assert (folder, kind) == ("/store_00010001", GP_FILE_TYPE_NORMAL)
        device.check("file_get")
        return CameraFile(device.files[name])

    def file_delete(self, folder: str, name: str) -> None:
        del device.files[name]
