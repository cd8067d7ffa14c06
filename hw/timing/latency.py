"""Latency of a projector, calibrated with flashes: black and white pictures that tell how late its light follows."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import cycle, islice
from math import inf, isfinite
from statistics import median

import numpy as np

from calib.numerics import Image
from hw.errors import DeviceError, FrameLostError
from hw.rig import Frame
from hw.timing.devices import ATTEMPTS, BufferedProjector, TriggeredCamera
from hw.timing.resting import RestingLight

LONGEST_LATENCY_S = 0.3
_RESTING_FRAMES = 3
_FLASHES = 4
_FLASHES_AT_MOST = 50
_LONGEST_FLASH_S = 5.0
_AT_ONCE_S = 0.002  # the trigger comes a moment after the swap
_EDGE = 0.05  # less than this share of the light missing: the exposure began after the light had come
_REHEARSED = 4


LOST_ADVICE = (
    "Check cable and power; give the camera a network interface of its own, with large packets (packet_size) and a "
    "large receive buffer; then rerun."
)


@dataclass(frozen=True)
class _Arrival:
    """When the light of a flash came: `seen` coming during an exposure, or else some time before the next began.

    `after_s`: from the end of its swap, which took `swapping_s`; not sooner than `soonest_s` after the swap's begin.
    """

    after_s: float
    seen: bool
    soonest_s: float
    swapping_s: float


@dataclass(frozen=True)
class Latency:
    """Seconds until all light of a picture is there: not before `soonest_s` from the begin of its swap, nor after
    `latest_s` from the swap's end, in any of several flashes. Swaps took up to `swapping_s`, and the camera usually
    `cycle_s` from a trigger until its frame was there.
    """

    soonest_s: float
    latest_s: float
    swapping_s: float
    cycle_s: float


class LatencyCalibration:
    """Measures, with frames of black and white pictures, what share of the light of a new picture an exposure missed.

    Construction learns what the camera sees of resting pictures. Raises DeviceError if it sees no difference.
    """

    def __init__(self, projector: BufferedProjector, camera: TriggeredCamera) -> None:
        self._projector = projector
        self._camera = camera
        width, height = projector.size
        self._pictures = tuple(np.full((height, width), level, np.uint8) for level in (0, 255))
        dark, bright = self._resting(0), self._resting(1)
        self._shown = 1
        self._cycles_s: list[float] = []
        self._rest = RestingLight(camera, dark, bright)
        self.tolerance = self._rest.tolerance
        self.sums = self._rest.sums

    def latency(self) -> Latency:
        """How late light follows a swap, the soonest and the latest of several flashes.

        Of light that comes during an exposure, the missing share tells when it came. The first flash is followed by
        exposures one after the other to see about when that is, the next are placed so that it comes amid an exposure.
        Raises DeviceError if the light does not come, or frames do not arrive.
        """
        seen: list[_Arrival] = []
        soonest_s, first_s = inf, 0.0
        for number in range(_FLASHES_AT_MOST):
            waits_s = self._camera.wait_s if isfinite(self._camera.wait_s) else 0.0
            # Light that comes soon may always be there before a camera that runs freely begins.
            arrival = self._flash(first_s, _AT_ONCE_S + waits_s * (number > 2 * _FLASHES))
            if arrival is None:
                continue
            if arrival.seen:
                seen.append(arrival)
            if len(seen) == _FLASHES:
                return Latency(
                    min(each.soonest_s for each in seen),
                    max(each.after_s for each in seen),
                    max(each.swapping_s for each in seen),
                    median(self._cycles_s),
                )
            soonest_s = min(soonest_s, arrival.after_s)  # exposures that begin late see it later than it was there
            early_s = (
                self._camera.exposure_s / 2 + waits_s * (number % _FLASHES) / _FLASHES
            )  # when it begins, is chance
            first_s = max(0.0, soonest_s - early_s)
        raise DeviceError(
            f"camera {self._camera.name}: {_FLASHES_AT_MOST} flashes did not tell when the projector's light comes: "
            "frames were lost, or the light does not come evenly. Check the camera's cable and network, turn off the "
            "projector's automatics, then rerun."
        )

    def largest_missing_share(
        self, frames: Callable[[Iterable[Image]], Iterator[Frame]], count: int = _REHEARSED
    ) -> float:
        """Take frames of black and white alternately by `frames`; the largest share by which a part of one differs
        from rest."""
        targets = list(islice(cycle((1 - self._shown, self._shown)), count))
        taken = frames(self._pictures[target] for target in targets)
        shares = [
            float(np.abs(self._rest.missing(frame.image, target)).max())
            for target, frame in zip(targets, taken, strict=True)
        ]
        self._shown = targets[-1]
        return max(shares)

    def _flash(self, first_s: float, at_once_s: float) -> "_Arrival | None":
        """Change the picture, and expose from `first_s` after the flip until it rests; None if a lost frame hid it."""
        self._shown = 1 - self._shown
        self._projector.prepare(self._pictures[self._shown])
        swap = self._projector.flip()
        flipped_s = swap.done_s
        time.sleep(max(0.0, flipped_s + first_s - time.monotonic()))
        arrival: _Arrival | None = None
        hidden = False
        while time.monotonic() - flipped_s < _LONGEST_FLASH_S:
            begin_s = self._camera.expose()
            try:
                frame = self._camera.collect()
                self._cycles_s.append(time.monotonic() - begin_s)
                missing = float(self._rest.missing(frame.image, self._shown).mean())
            except FrameLostError:
                hidden = hidden or arrival is None
                continue
            if arrival is None and missing < 1 - _EDGE:
                late_s = self._camera.late_s + max(0.0, missing) * self._camera.exposure_s
                after_s, swapping_s = begin_s - flipped_s + late_s, flipped_s - swap.begun_s
                if missing > _EDGE:
                    arrival = _Arrival(after_s, True, after_s + swapping_s, swapping_s)
                else:
                    arrival = _Arrival(after_s, begin_s - flipped_s < at_once_s, 0.0, swapping_s)
            if arrival is not None and missing < _EDGE:
                return arrival if arrival.seen or not hidden else None
        raise DeviceError(
            f"projector: {_LONGEST_FLASH_S:.0f} s after a change of the picture, camera {self._camera.name} still does "
            "not see the new one. Check that it looks at the projector's light, and that its frames arrive, then rerun."
        )

    def _grab(self) -> Image:
        for _ in range(ATTEMPTS):
            try:
                return self._camera.grab().image
            except FrameLostError as error:
                lost = error
        raise DeviceError(
            f"camera {self._camera.name}: its frames do not arrive ({lost}), {ATTEMPTS} times in a row. {LOST_ADVICE}"
        )

    def _resting(self, which: int) -> list[Image]:
        self._projector.show(self._pictures[which])
        time.sleep(LONGEST_LATENCY_S)
        return [self._grab() for _ in range(_RESTING_FRAMES)]
