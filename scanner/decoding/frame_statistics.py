"""Everything that is computed from the frames one by one, as they arrive from a camera or are read again."""

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np

from calib.numerics import Image
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.arrays import Part
from scanner.decoding.frame_corrections import FrameCorrections
from scanner.decoding.light.camera_response import camera_response
from scanner.decoding.light.equalise import PairEqualiser
from scanner.decoding.light.ghost import find_ghost
from scanner.decoding.light.lit_pixels import unclipped
from scanner.decoding.light.noise_model import NoiseModel, measure_noise, needs_neighbours
from scanner.decoding.light.saturation_level import saturation_level
from scanner.decoding.samples import Samples
from scanner.decoding.sequence_plan import SequencePlan


class FrameStatistics:
    """Full-size running images, and samples of all frames."""

    def __init__(self, plan: SequencePlan, first: Image) -> None:
        self.samples = Samples.of((first.shape[0], first.shape[1]), neighbours=needs_neighbours(plan))
        pairs = PairEqualiser(plan, self.samples.scattered)
        self.accumulators = Accumulators(plan, first, pairs, self.samples.scattered.pixels)
        self._plan, self._count = plan, 0
        self._of_fringes = frozenset(frame for fringe in plan.fringes for frame in fringe.frames)

    def add(self, grey: Image) -> None:
        """Fold in the next frame (H, W), which must not be modified afterwards."""
        number = self._plan.shown[self._count]
        if number in self._of_fringes:
            self.samples.tiles.add(self._count, grey)
        # A repeated pattern is only used to detect changes since it was first shown.
        if number not in self._plan.shown[: self._count]:
            self.samples.scattered.add(number, grey)
            self.samples.grid.add(number, grey)
            self.accumulators.add(number, grey)
        self._count += 1

    def corrections(self) -> FrameCorrections:
        """Estimate what affected all frames: a nonlinear response, and ghosting."""
        pixels, peak, top = self.samples.scattered, self.accumulators.peak, self.accumulators.brightest.max()
        taken, saturation = pixels.as_taken, saturation_level(peak)
        lit = unclipped(taken, saturation)
        seen = taken[:, lit]
        top = np.iinfo(np.uint8).max if top.dtype == np.uint8 else top
        response = camera_response(self._plan, seen.astype(np.float32), saturation, float(top))
        light = response.light_of(seen) if response else seen
        return FrameCorrections(response, find_ghost(self._plan, light.astype(np.float32), pixels.rows[lit]))

    def noise(self) -> NoiseModel:
        """Measure the noise of the frames as they were taken."""
        return measure_noise(self._plan, self.samples.scattered, saturation_level(self.accumulators.peak))


def frame_statistics(plan: SequencePlan, frames: Iterable[Image]) -> FrameStatistics:
    """Fold all frames (H, W) of a capture, at least one."""
    remaining = iter(frames)
    first = next(remaining)
    found = FrameStatistics(plan, first)
    for frame in chain([first], remaining):
        found.add(frame)
    return found


def frames_alike(
    accumulators: Accumulators, corrections: FrameCorrections, frames: Image, part: Part
) -> Iterator[tuple[int, Image]]:
    """Yield the index of each pattern, and a part of its image as it was folded, from the kept frames (N, H, W)."""
    return accumulators.alike(corrections.undone(frames, accumulators.plan, part), part)
