"""The backend of GenICam cameras: loads the driver, or says what to install if Aravis is missing."""

from types import ModuleType

from hw.errors import DeviceError
from hw.optional_parts import RIG


def load() -> ModuleType:
    """The module `hw.aravis.camera`. Raises DeviceError, naming what to install, if Aravis is missing."""
    try:
        from hw.aravis import camera  # only now, for most users have no Aravis
    except (ImportError, ValueError) as error:  # ValueError: gi is there, Aravis is not
        raise DeviceError(RIG.missing("a GenICam camera", "Aravis with PyGObject")) from error
    return camera
