"""What is said of captures during which something moved."""

from collections.abc import Iterator
from contextlib import contextmanager

from calib.refusal import RefusalError
from scanner.decoding.motion.found import MotionFound
from scanner.errors import InputError

ADVICE = "Fasten what moved, let a projector warm up, keep away from the rig while it captures, and capture again."
# Frames that were exchanged contradict each other in ways that hardly any motion explains.
_EXPLAINED = 0.5


@contextmanager
def blaming(motion: MotionFound | None) -> Iterator[None]:
    """Frames that contradict each other in the block do so because something moved, if that explains it.

    Raises RefusalError in the place of InputError.
    """
    try:
        yield
    except InputError as error:
        if motion is None or not motion.significant or motion.explained < _EXPLAINED:
            raise
        raise moved(motion) from error


def moved(motion: MotionFound) -> RefusalError:
    """The refusal of a capture that this motion has spoilt."""
    return RefusalError(f"{_capital(motion)}.", ADVICE)


def remarks_on(motion: MotionFound | None) -> tuple[str, ...]:
    """What a person should know of a motion that can be put up with."""
    if motion is None or not motion.significant or motion.is_too_large:
        return ()
    return (f"{_capital(motion)}; that was taken back, and what may be left of it is part of the sigmas.",)


def _capital(motion: MotionFound) -> str:
    sentence = str(motion)
    return sentence[0].upper() + sentence[1:]
