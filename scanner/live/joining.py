"""Kept clouds of a thing that is turned, put together as they come: which lie on each other, and which on none."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Thread

from calib.geometry import Calibration
from scanner.live.watching import Newest
from scanner.objects.solve import register_stations
from scanner.results import Decoded

# Of fewer, what rests is not told from what was turned.
FEWEST = 4


def joined_text(captures: Sequence[Decoded], calibration: Calibration) -> str:
    """Which stations have their places by now."""
    found = register_stations(captures, calibration)
    placed = len(found.places)
    if placed < 2:
        return f"None of the {len(captures)} stations lies on another yet: turn the thing less from one to the next."
    said = f"{placed} of {len(captures)} stations lie on each other."
    outside = [captures[each.view].name for each in found.left_out]
    return (
        f"{said} Not yet: {', '.join(outside)}; stations between them and the others would join them."
        if outside
        else said
    )


@contextmanager
def joining(calibration: Calibration, tell: Callable[[str], None]) -> Iterator[Callable[[Sequence[Decoded]], None]]:
    """What takes all stations kept so far, and has them joined in a thread of its own, the newest ones only.

    The last ones are joined before the context ends. What fails there is told, for the stations are safe.
    """
    slot = Newest[Sequence[Decoded]]()

    def join() -> None:
        while (captures := slot.take()) is not None:
            try:
                tell(joined_text(captures, calibration))
            except Exception as error:
                tell(f"The stations could not be joined yet: {error}")

    thread = Thread(target=join, name="joining", daemon=True)
    thread.start()
    try:
        yield slot.put
    finally:
        slot.finish()
        thread.join()
