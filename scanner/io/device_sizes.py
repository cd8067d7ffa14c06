"""Files that belong to other devices than is expected are told by the sizes of their images."""

from collections.abc import Iterable

from calib.geometry import Size
from scanner.errors import InputError


def refuse_other_sizes(
    what: object, actual: Iterable[Size], expected: Iterable[Size], whose: str, why: str = ""
) -> None:
    """Raise InputError if the sizes of camera and projector differ; `expected` are `whose`, `why` ends the message."""
    for name, size, wanted in zip(("camera", "projector"), actual, expected, strict=True):
        if size != wanted:
            raise InputError(f"{what}: its {name} is {size}, but {whose} is {wanted}{why}")
