"""The table of camera backends: what `rig: {backend: …}` may name beside `simulated`. A new one is one more row."""

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
    """`load` gives the driver. It raises DeviceError, naming what to install, if something that it needs is missing."""

    name: str
    settings: type[CameraRigSettings]
    load: Callable[[], CameraDriver]


BACKENDS = (
    Backend("aravis", AravisRigSettings, aravis.load),
    Backend("opencv", opencv.OpenCVRigSettings, opencv.load),
    Backend("gphoto2", gphoto2.GPhotoRigSettings, gphoto2.load),
)


def backend_of(settings: CameraRigSettings) -> Backend:
    """The one whose settings these are."""
    return next(backend for backend in BACKENDS if backend.name == settings.backend)


def _with_backend(data: Any) -> Any:
    """A rig of which nothing is said but its seed is simulated."""
    return {"backend": "simulated"} | data if isinstance(data, dict) else data


# What `rig:` in a configuration may be.
if TYPE_CHECKING:
    RigSettings = SimulatedRigSettings | CameraRigSettings
else:
    RigSettings = Annotated[
        reduce(or_, (backend.settings for backend in BACKENDS), SimulatedRigSettings),
        Field(discriminator="backend"),
        BeforeValidator(_with_backend),
    ]
