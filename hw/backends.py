"""The table of camera backends: the values of `rig: {backend: …}` other than `simulated`. A new backend is a row."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field

from hw import gphoto2, opencv
from hw.aravis import backend as aravis
from hw.aravis.settings import AravisRigSettings
from hw.cameras import CameraDriver
from hw.settings import CameraRigSettings, SimulatedRigSettings


@dataclass(frozen=True)
class Backend:
    """A kind of camera. `load` returns its driver, or raises DeviceError naming what to install."""

    name: str
    settings: type[CameraRigSettings]
    load: Callable[[], CameraDriver]


BACKENDS = (
    Backend("aravis", AravisRigSettings, aravis.load),
    Backend("opencv", opencv.OpenCVRigSettings, opencv.load),
    Backend("gphoto2", gphoto2.GPhotoRigSettings, gphoto2.load),
)


def backend_of(settings: CameraRigSettings) -> Backend:
    """The backend that these settings belong to."""
    return next(backend for backend in BACKENDS if backend.name == settings.backend)


def _with_backend(data: Any) -> Any:
    """The backend is `simulated` unless the configuration names one."""
    return {"backend": "simulated"} | data if isinstance(data, dict) else data


# The type of `rig:` in a configuration.
if TYPE_CHECKING:
    RigSettings = SimulatedRigSettings | CameraRigSettings
else:
    RigSettings = Annotated[
        reduce(or_, (backend.settings for backend in BACKENDS), SimulatedRigSettings),
        Field(discriminator="backend"),
        BeforeValidator(_with_backend),
    ]
