"""Latency calibration of a projector with flashes: changes between black and white."""

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
_EDGE = 0.05  # if less than this share of the light is missing, the exposure began after the light had arrived
_REHEARSED = 4


LOST_ADVICE = (
    "Check cable and power; give the camera a network interface of its own, with large packets (packet_size) and a "
    "large receive buffer; then rerun."
)


@dataclass(frozen=True)
class _Arrival:
    """When the light of a flash arrived. `seen`: during an exposure; otherwise some time before the next began.

    `after_s`: measured from the end of its swap, which took `swapping_s`. `soonest_s`: lower limit from the swap's
    begin.
    """

    after_s: float
    seen: bool
    soonest_s: float
    swapping_s: float


@dataclass(frozen=True)
class Latency:
    """The latency from a swap to the light of its picture, in seconds, as the range over several flashes.

    Light arrives no sooner than `soonest_s` after the swap's begin, and no later than `latest_s` after its end. Swaps
    took up to `swapping_s`; the camera's median time from trigger to frame is `cycle_s`.
    """

    soonest_s: float
    latest_s: float
    swapping_s: float
    cycle_s: float


class LatencyCalibration:
    """Measures with black and white pictures which share of a new picture's light an exposure missed.

    Construction records both pictures at rest. Raises DeviceError if the camera sees no difference.
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
        """Measure the latency from several flashes.

        If light arrives during an exposure, the missing share gives its time. Exposures in a row after the first flash
        find it approximately; later exposures are placed so that light arrives in their middle. Raises DeviceError if
        the light does not arrive, or if frames do not.
        """
        seen: list[_Arrival] = []
        soonest_s, first_s = inf, 0.0
        for number in range(_FLASHES_AT_MOST):
            waits_s = self._camera.wait_s if isfinite(self._camera.wait_s) else 0.0
            # Light may always arrive before a free-running camera begins to expose.
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
            soonest_s = min(soonest_s, arrival.after_s)  # late exposures only give an upper limit
            early_s = (
                self._camera.exposure_s / 2 + waits_s * (number % _FLASHES) / _FLASHES
            )  # vary the phase of a free-running camera
            first_s = max(0.0, soonest_s - early_s)
        raise DeviceError(
            f"camera {self._camera.name}: {_FLASHES_AT_MOST} flashes did not tell when the projector's light comes: "
            "frames were lost, or the light does not come evenly. Check the camera's cable and network, turn off the "
            "projector's automatics, then rerun."
        )

    def largest_missing_share(
        self, frames: Callable[[Iterable[Image]], Iterator[Frame]], count: int = _REHEARSED
    ) -> float:
        """Take frames of black and white alternately with `frames`; returns the largest share by which a band of rows
        differs from rest."""
        targets = list(islice(cycle((1 - self._shown, self._shown)), count))
        taken = frames(self._pictures[target] for target in targets)
        shares = [
            float(np.abs(self._rest.missing(frame.image, target)).max())
            for target, frame in zip(targets, taken, strict=True)
        ]
        self._shown = targets[-1]
        return max(shares)

    def _flash(self, first_s: float, at_once_s: float) -> "_Arrival | None":
        """Change the picture, and expose from `first_s` after the flip until it is at rest.

        None if a lost frame hid the change.
        """
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
