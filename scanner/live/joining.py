"""Kept clouds are joined as they come, which shows what is missing."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Thread

from calib.geometry import Calibration
from scanner.live.watching import Newest
from scanner.objects.solve import advice_on, brief, outside_text, stations_outside
from scanner.results import Decoded
from scanner.rooms.live import Comparison

_FEWEST = 4  # stations of a thing; with fewer, background and thing are not separable
_LEAVING_S = 60.0


def joined_text(captures: Sequence[Decoded], calibration: Calibration) -> list[str]:
    """Which stations of a thing have their places by now."""
    if len(captures) < _FEWEST:
        return []
    outside = stations_outside(captures, calibration)
    placed = len(captures) - len(outside)
    if placed < 2:
        return [f"No two stations fit together yet: {outside_text(outside)}. {advice_on(outside)}"]
    if not outside:
        return [f"{placed} stations fit together."]
    names = brief([each.name for each in outside])
    return [f"{placed} stations fit together, but not yet {names}: put stations between them and the others."]


@contextmanager
def joining(
    calibration: Calibration, tell: Callable[[str], None], *, of_room: bool
) -> Iterator[Callable[[Sequence[Decoded]], None]]:
    """A function that takes all stations kept so far, and joins the newest ones in a thread.

    The last ones are joined before the context ends, if that takes at most a minute. Errors are reported and not
    raised, because the stations are safe.
    """
    slot = Newest[Sequence[Decoded]]()
    comparison = Comparison() if of_room else Comparison(compare=joined_text)

    def join() -> None:
        while (captures := slot.take()) is not None:
            try:
                for sentence in comparison.guidance(captures, calibration):
                    tell(sentence)
            except Exception as error:
                tell(f"The stations could not be joined yet: {error}")

    thread = Thread(target=join, name="joining", daemon=True)
    thread.start()
    try:
        yield slot.put
    finally:
        slot.finish()
        thread.join(_LEAVING_S)
        if thread.is_alive():
            tell("Joining the last stations takes longer than a minute, and is left to the command below.")
