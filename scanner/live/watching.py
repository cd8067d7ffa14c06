"""The loop: rounds are taken here, and decoded in another thread; slow observers get only the newest cloud.

Texts about live clouds.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from threading import Condition, Thread
from typing import Generic, TypeVar

import numpy as np

from hw.errors import DeviceError
from scanner.decoding import MaskReason
from scanner.live.cloud import LiveCloud, LiveDecoder, Round
from scanner.quantities import percent, shown_unit

T = TypeVar("T")

log = logging.getLogger(__name__)

_RECENT = 20  # clouds used for rate and delay
_LEAVING_S = 60.0
_MANY_SATURATED, _FEW_LIT, _ALL_MOVES = 0.02, 0.1, 0.5


class Newest(Generic[T]):
    """Holds one thing; a newer one takes its place. `dropped`: how many were never taken."""

    def __init__(self) -> None:
        self._there = Condition()
        self._held: T | None = None
        self._closed = False
        self.dropped = 0

    def put(self, item: T) -> None:
        """Returns at once."""
        with self._there:
            self.dropped += self._held is not None
            self._held = item
            self._there.notify()

    def take(self) -> T | None:
        """Wait for the next one; None if there will be none."""
        with self._there:
            self._there.wait_for(lambda: self._held is not None or self._closed)
            newest, self._held = self._held, None
            return newest

    def finish(self) -> None:
        """What is held is the last."""
        with self._there:
            self._closed = True
            self._there.notify_all()


@dataclass
class Account:
    """What became of the rounds. `lost`: a frame was; `contradicting`: frames were not of one scene; `skipped`: there
    was no time to decode them. `came_s` of the last clouds, and `delays_s` from then on until they were there.
    """

    clouds: int = 0
    lost: int = 0
    contradicting: int = 0
    skipped: int = 0
    came_s: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT))
    delays_s: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT))

    def begin(self) -> None:
        """Restart the measurement of rate and delay."""
        self.came_s.clear()
        self.delays_s.clear()

    def add(self, cloud: LiveCloud) -> None:
        """One more."""
        self.clouds += 1
        self.came_s.append(cloud.taken.came_s)
        self.delays_s.append(time.monotonic() - cloud.taken.came_s)

    @property
    def rate_hz(self) -> float:
        """Clouds a second, of the last ones; 0 before there are two."""
        spans = len(self.came_s) - 1
        return spans / (self.came_s[-1] - self.came_s[0]) if spans > 0 and self.came_s[-1] > self.came_s[0] else 0.0

    @property
    def delay_s(self) -> float:
        """From the last frame of a round to its cloud, on average."""
        return sum(self.delays_s) / max(1, len(self.delays_s))


def proven(decoder: LiveDecoder, taken: Round, earlier: list[LiveCloud]) -> LiveCloud | None:
    """The cloud of a round that agrees with an `earlier` one, the last good one or one that was dropped after it, which
    this brings up to date; None where it agrees with none, as the first.

    A frame that is late makes a round that is like no other. It is dropped, and the one after it is not.
    """
    for before in earlier:
        cloud = decoder.cloud(taken, before)
        if not cloud.contradicts_itself:
            earlier[:] = [cloud]
            return cloud
    alone = decoder.cloud(taken)
    if not alone.contradicts_itself:
        earlier[1:] = [alone]
    return None


def watch(
    taken: Generator[Round | None],
    decoder: LiveDecoder,
    on_round: Callable[[LiveCloud | None, Account], None],
    has_ended: Callable[[], bool],
    account: Account,
) -> None:
    """Decode rounds until `has_ended` returns True, which is called between rounds.

    `on_round` is called in the decoder's thread, with None for a round without a cloud; its exceptions are raised here.
    `account` is kept up to date. Raises DeviceError if the last round is not finished within a minute, for example if a
    disk does not respond.
    """
    slot, failures = Newest[Round](), list[BaseException]()
    account.begin()

    def decode() -> None:
        earlier: list[LiveCloud] = []
        first = True  # there is nothing to compare it with
        try:
            while (following := slot.take()) is not None:
                cloud = proven(decoder, following, earlier)
                if cloud is None:
                    account.contradicting += not first
                else:
                    account.add(cloud)
                first = False
                on_round(cloud, account)
        except BaseException as error:
            failures.append(error)

    thread = Thread(target=decode, name="live decoder", daemon=True)
    thread.start()
    try:
        with closing(taken) as following:
            for item in following:
                if item is None:
                    account.lost += 1
                else:
                    slot.put(item)
                if failures or has_ended():
                    break
    finally:
        slot.finish()
        thread.join(_LEAVING_S)
        account.skipped += slot.dropped
    if failures:
        raise failures[0]
    if thread.is_alive():
        raise DeviceError(f"a cloud was not finished within {_LEAVING_S:.0f} s: check whether the disk responds")


def cloud_text(cloud: LiveCloud, unit: str) -> str:
    """Number of points, and their accuracy."""
    sigma = shown_unit(unit).error(float(np.median(cloud.sigma))) if len(cloud.points) else "-"
    return f"{len(cloud.points):,} points, sigma {sigma}"


def advice(cloud: LiveCloud) -> Iterator[str]:
    """Sentences on what should be otherwise."""
    saturated = cloud.share(MaskReason.SATURATED)
    if saturated > _MANY_SATURATED:
        yield f"{percent(saturated)} of what is lit is overexposed: shorten the exposure, or close the aperture."
    if cloud.lit < _FEW_LIT * cloud.reason.size:
        yield f"Only {percent(cloud.lit / cloud.reason.size)} of the pixels see the fringes: more light, or closer."
    if cloud.moving_share > _ALL_MOVES:
        yield "Nearly everything moves: hold still for a moment."


def round_texts(cloud: LiveCloud | None, account: Account, unit: str) -> list[str]:
    """Texts about the newest round, with or without a cloud."""
    if cloud is None:
        return ["No cloud this time: the scene or the rig moved between frames. Waiting for it to rest."]
    left_out = cloud.share(MaskReason.INCONSISTENT, MaskReason.MOVED, MaskReason.ISOLATED)
    rate = f"{account.rate_hz:.1f} clouds a second" if account.rate_hz else "The first cloud"
    return [
        f"{rate}, {1000 * account.delay_s:.0f} ms after its last frame; {cloud_text(cloud, unit)}; "
        f"{percent(cloud.moving_share)} moves, {percent(left_out)} is left out.",
        *advice(cloud),
    ]


def result_texts(kept: int, out: Path, config: Path, calibration: Path, *, of_room: bool = False) -> Iterator[str]:
    """Where kept clouds are, and the one next step."""
    yield f"Result: {out} ({kept} {'station' if kept == 1 else 'stations'} in captures)"
    if kept > 1:
        kind = "room" if of_room else "object"
        yield (
            f"→ scan {kind} {out} --config {config} --calibration {calibration} --out {out}-{kind} puts them together."
        )


def account_text(account: Account) -> str:
    """What became of the rounds."""
    parts = [f"{account.clouds} clouds"]
    for count, what in (
        (account.lost, "lost a frame"),
        (account.contradicting, "had frames that contradict each other"),
        (account.skipped, "came while others were decoded"),
    ):
        if count:
            parts.append(f"{count} rounds {what}")
    return f"{', '.join(parts)}."
