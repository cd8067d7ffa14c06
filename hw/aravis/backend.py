"""The backend of GenICam cameras: loads the driver, or says what to install if Aravis is missing."""

from types import ModuleType

from hw.errors import DeviceError
from hw.optional_parts import RIG


def load() -> ModuleType:
    """The module `hw.aravis.camera`. Raises DeviceError, naming what to install, if Aravis is missing."""
    with RIG.needed("a GenICam camera", "Aravis with PyGObject", DeviceError):
        from hw.aravis import camera  # only now, for most users have no Aravis
    return camera
