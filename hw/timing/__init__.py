"""Assigns frames to pictures: latency calibration, sequential and pipelined acquisition, frame verification."""

from hw.timing.devices import ATTEMPTS, TRIGGER_LAG_S, Swap, nothing, whole_periods
from hw.timing.frame_reader import Arrival, FrameReader
from hw.timing.streaming import StreamedRig, streamed
from hw.timing.synchronisation import SynchronisedRig, synchronised
from hw.timing.timed_rig import MOST_AHEAD, TimedRig
