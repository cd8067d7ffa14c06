"""PyAV, an extra that reads and writes video; it is imported on demand."""

from types import ModuleType

from hw.optional_parts import VIDEO
from scanner.errors import InputError


def av() -> ModuleType:
    """Raise InputError that names the extra if PyAV cannot be imported."""
    with VIDEO.needed("video", "av", InputError):
        import av as library
    library.logging.set_level(library.logging.PANIC)  # errors of a file are raised as exceptions instead
    module: ModuleType = library
    return module
