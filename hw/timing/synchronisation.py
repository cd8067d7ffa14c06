"""Synchronises a triggered camera and a projector without a trigger line.

A picture reaches the wall some tens of milliseconds after its swap. Flashes measure this latency. Acquisition is then
pipelined (`pipelined.py`), or sequential where that does not work (`sequential.py`).
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Frames, Redundancy, Rig
from hw.timing.devices import TRIGGER_LAG_S, BufferedProjector, CameraGroup, TriggeredCamera
from hw.timing.latency import LONGEST_LATENCY_S, LOST_ADVICE, Latency, LatencyCalibration
from hw.timing.pipelined import PipelinedAcquisition
from hw.timing.sequential import SequentialAcquisition, Timing
from hw.timing.timed_rig import TimedRig
from hw.timing.trigger_schedule import AT_REST, pace

log = logging.getLogger(__name__)

# Margin beyond the slowest flash, for vertical sync and inexact clocks and schedulers.
_MARGIN_S = 0.004
_ROUNDS = 8
# Pipelined, the margin costs time in every frame.
_PIPELINED_MARGINS_S = (0.001, 0.003, 0.006, 0.012, 0.024)
_REHEARSED_PIPELINED = 8


def _rehearsed_sequential(
    calibration: LatencyCalibration, projector: BufferedProjector, cameras: CameraGroup, latency_s: float
) -> Timing:
    """Find the shortest delay of sequential acquisition, by rehearsing it with frames of black and white.

    The rehearsal shows pictures that arrive too late. With overlap it also shows the next picture arriving too early:
    in the last rows of a rolling shutter, or in a late exposure. Raises DeviceError if the light does not settle.
    """
    timing = Timing(latency_s, latency_s + _MARGIN_S, overlaps=latency_s > TRIGGER_LAG_S)
    for _ in range(_ROUNDS):
        shares = calibration.missing_shares(SequentialAcquisition(projector, cameras, timing).frames)
        missing = float(shares.max())
        log.info("%s: %.2f %% of the light missing", timing, 100 * missing)
        if np.all(shares < calibration.tolerances):
            return timing
        if timing.overlaps:
            timing = replace(timing, overlaps=False)
        else:
            late_s = max(_MARGIN_S, missing * cameras.exposure_s)  # light may decay more slowly than its share suggests
            timing = Timing(timing.latency_s + late_s, timing.delay_s + late_s, overlaps=False)
    raise DeviceError(
        f"projector: its light does not settle: {1e3 * timing.delay_s:.0f} ms after a flip, an exposure still differs "
        f"by {100 * missing:.1f} % from one of a resting picture. Turn off whatever adapts (dynamic contrast, "
        "automatic iris, eco mode), keep daylight and people out, then rerun."
    )


def _rehearsed_pipelined(
    calibration: LatencyCalibration,
    measured: Latency,
    projector: BufferedProjector,
    cameras: CameraGroup,
    sequential: SequentialAcquisition,
) -> PipelinedAcquisition | None:
    """Find the shortest period of pipelined acquisition, by rehearsing it; None if it is not faster or not possible.

    The rehearsal shows the same faults as in sequential acquisition, and any change of latency by other pictures on
    their way.
    """
    for margin_s in _PIPELINED_MARGINS_S:
        rhythm = pace(measured, cameras, margin_s)
        if rhythm.period_s > sequential.period_s(measured.cycle_s) + cameras.wait_s:
            break
        pipelined = PipelinedAcquisition(projector, cameras, sequential, rhythm, calibration.sums)
        shares = calibration.missing_shares(pipelined.rehearse, _REHEARSED_PIPELINED)
        log.info("%s: %.2f %% of the light missing, %d missed", rhythm, 100 * shares.max(), pipelined.missed)
        if np.all(shares < calibration.tolerances):
            return pipelined
    return None


@dataclass(eq=False, kw_only=True)
class SynchronisedRig(TimedRig):
    """A rig with triggered cameras, which expose together. Acquisition is pipelined where that works and each camera
    takes one frame of each picture; otherwise it is sequential. `verified` repeats frames that contain another picture,
    in either mode.
    """

    lost_advice = LOST_ADVICE

    timing: Timing
    sequential: SequentialAcquisition
    verified: PipelinedAcquisition | None = None
    _was_pipelined: bool = field(default=False, init=False)
    """Whether the acquisition of the last frames was."""

    @property
    def pipelined(self) -> PipelinedAcquisition | None:
        """The pipelined acquisition, if it works with these devices."""
        return self.verified if self.verified is not None and self.verified.rhythm.pipelines else None

    @property
    def least_s(self) -> float:
        """The exposure and, in sequential acquisition, the latency."""
        return self.sequential.exposure_s + (0.0 if self._was_pipelined else self.latency_s)

    def _acquired(
        self, images: Iterable[Image], exposures_us: Sequence[float], redundancy: Redundancy
    ) -> Iterator[Frames]:
        verified = self.verified if redundancy and not exposures_us else None
        if verified is not None and verified.possible:
            self._was_pipelined = verified.rhythm.pipelines
            return verified.frames(images, redundancy)
        self._was_pipelined = False
        return self.sequential.frames(images, exposures_us)

    def _measured(self) -> Mapping[str, object]:
        measured: dict[str, object] = {
            "delay_ms": round(1e3 * self.timing.delay_s, 2),
            "overlapping": self.timing.overlaps,
        }
        if self.pipelined is not None and self._was_pipelined:
            measured |= {
                "pictures_in_flight": self.pipelined.rhythm.outstanding,
                "missed_in_flight": self.pipelined.missed,
                "doubted_frames": self.pipelined.doubted,
            }
        return measured


def synchronised(
    projector: BufferedProjector,
    camera: TriggeredCamera,
    identity: dict[str, str],
    refresh_hz: float | None = None,
    further: Sequence[tuple[TriggeredCamera, dict[str, str]]] = (),
) -> SynchronisedRig:
    """Calibrate the latency, rehearse the acquisition (about four seconds), and return the rig; `others`: further
    cameras with their identities.

    If a camera has no clock, the delay is the longest latency of any projector. Raises DeviceError if a camera does not
    see the projector, or if its light does not settle.
    """
    cameras = CameraGroup([camera, *(further_camera for further_camera, _ in further)])
    calibration = LatencyCalibration(projector, cameras)
    if not cameras.has_clock:  # flashes measure nothing if the begin of exposures is unknown
        timing = _rehearsed_sequential(calibration, projector, cameras, LONGEST_LATENCY_S)
        light = f"within {1e3 * timing.delay_s:.0f} ms (waited for)"
    else:
        measured = calibration.latency()
        timing = _rehearsed_sequential(calibration, projector, cameras, measured.latest_s)
        light = f"{1e3 * timing.latency_s:.1f} ms (measured)"
    sequential = SequentialAcquisition(projector, cameras, timing)
    verified = None
    if cameras.has_clock and isfinite(cameras.wait_s):
        verified = _rehearsed_pipelined(calibration, measured, projector, cameras, sequential)
    if verified is None:
        verified = PipelinedAcquisition(projector, cameras, sequential, AT_REST, calibration.sums)
    flip = {"light after a flip": light}
    return SynchronisedRig(
        projector,
        camera,
        identity | flip,
        refresh_hz,
        others=tuple(Rig(projector, further_camera, known | flip, refresh_hz) for further_camera, known in further),
        latency_s=timing.latency_s,
        tally=sequential.tally,
        timing=timing,
        sequential=sequential,
        verified=verified,
    )
