"""What was found of a motion of camera or projector during a capture, and what it did to the coordinates."""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from calib.numerics import Floats
from calib.refinement import Shifts
from scanner.decoding.arrays import Floats32
from scanner.decoding.motion.rigid import PER_DEVICE, shifts_by_motion

# So much is taken back of what nothing confirms: a motion between the axes, or one that explains little.
_LARGEST_BUMP_PX = 0.35
# Of the shortest period. Sizes are told up to a sixth of it (measure.py); but a bump within a fringe also leaves up to
# a quarter of itself as a ripple in single matches.
_LARGEST_CYCLES = 1 / 8
# Of a slow motion, each fringe sees a part only. What is larger shifts coordinates by more than their gradient tells.
_LARGEST_PX = 3.0
# Of single frames: half a radian of a fringe of six pixels, beyond which its change is no longer linear.
_LARGEST_OF_FRAMES_PX = 0.5
# Drifts explain 80 to 90 % of what contradicts rest. What is called one and explains a third is a bump of many px.
_LEAST_EXPLAINED = 0.5
# A device counts as moved if its motion is this share of the other's.
_BOTH = 0.5
_SIZE = "{:.2g} px"
# What is taken back is known to this share of itself.
_REMAINDER = 0.1
# Between the axes, a motion of which nothing tells is taken to be of this size, one standard deviation.
SUSPECTED_PX = 0.3
_ROWS = 64


@dataclass(frozen=True)
class Disturbance:
    """Motions of the devices that x and y have taken part in, (2, 8), each as in `rigid`; sizes are (width, height)."""

    motions: Floats
    camera_size: tuple[int, int]
    projector_size: tuple[int, int]

    def shifts(self, camera_px: Floats, projector_px: Floats, gradient: Floats) -> Floats:
        """By how much it has shifted the coordinates of matches (N, 2), (N, 2), against each other.

        `gradient` (N, 2, 2): of the projector's coordinates (rows) by camera x and y.
        """
        by_motion = shifts_by_motion(camera_px, projector_px, gradient, self.camera_size, self.projector_size)
        shifts: Floats = np.einsum("nac,ac->na", by_motion, self.motions)
        return shifts

    def times(self, factor: float) -> "Disturbance":
        """The same, so many times as far."""
        return replace(self, motions=factor * self.motions)

    def less(self, other: "Disturbance") -> "Disturbance":
        """What one is beyond the other."""
        return replace(self, motions=self.motions - other.motions)

    def take_back(self, projector_px: Floats32) -> None:
        """Undo it in a map of the projector's coordinates (H, W, 2), as far as their gradient is known."""
        height, width, _ = projector_px.shape
        before = np.pad(projector_px, ((1, 1), (1, 1), (0, 0)), mode="edge")
        for top in range(0, height, _ROWS):
            rows = slice(top, min(top + _ROWS, height))
            around = before[rows.start : rows.stop + 2]
            by_x, by_y = around[1:-1, 2:] - around[1:-1, :-2], around[2:, 1:-1] - around[:-2, 1:-1]
            gradient = np.nan_to_num(np.stack([by_x, by_y], axis=3) / 2).reshape(-1, 2, 2)
            y, x = np.mgrid[rows, :width]
            camera_px = np.stack([x.reshape(-1), y.reshape(-1)], axis=1)
            here = projector_px[rows].reshape(-1, 2).astype(np.float64)
            projector_px[rows] -= self.shifts(camera_px, here, gradient).reshape(-1, width, 2)


@dataclass(frozen=True)
class MotionFound:
    """The motion that explains the fringes of a capture best, by `motion` (8,), as in `rigid`.

    `significant`: it is more than what is found at rest. `slow`: even, all the time; else at once, between the frames
    `first` and `last`. `size_px`: how far it moved the coordinates. `explained`: the share that it explains of what
    contradicts rest. `shift`: by what it shifted x and y against each other; `others`: the same of courses that explain
    it about as well. `unseen`: shifts of one standard deviation each that may have been beside it; `blind`: nothing
    in the frames tells whether one of the devices turned between the axes. `largest_px`: the largest bump that is taken
    back. `linear`: small enough that its size can be told. `undecided`: it may as well have been the other device, by
    itself. `one_by_one`: each frame by itself, of which `motion` is the root mean square, and `shift` the means over
    the fringes.
    """

    motion: Floats
    significant: bool
    slow: bool
    first: int
    last: int
    size_px: float
    explained: float
    shift: Disturbance
    others: tuple[Disturbance, ...]
    unseen: tuple[Disturbance, ...] = ()
    blind: bool = False
    largest_px: float = _LARGEST_BUMP_PX
    linear: bool = True
    undecided: bool = False
    one_by_one: bool = False

    @property
    def is_too_large(self) -> bool:
        """Whether single matches can no longer be trusted."""
        if self.one_by_one:
            return self.significant and self.size_px > _LARGEST_OF_FRAMES_PX
        largest_px = _LARGEST_PX if self.slow else self.largest_px
        if self.explained < _LEAST_EXPLAINED:
            largest_px = min(largest_px, _LARGEST_BUMP_PX)
        return self.significant and self.size_px > largest_px

    @property
    def shifts(self) -> Shifts:
        """By what the matches may be shifted: by what is left of a motion that was taken back."""
        likely = []
        if self.significant:
            likely = [each.less(self.shift).times(1 / sqrt(len(self.others))) for each in self.others]
            likely.append(self.shift.times(_REMAINDER))
        return Shifts(likely=tuple(each.shifts for each in likely), possible=tuple(each.shifts for each in self.unseen))

    def __str__(self) -> str:
        """In words, as in: the projector moved by 1.2 px between frames 18 and 24."""
        if self.one_by_one:
            _, px = turns_px(self.motion)
            return f"the camera's frames are each somewhere else, by {px:.2g} px"
        when = "slowly, from frame {} to {}" if self.slow else "between frames {} and {}"
        return f"{self._description()} {when.format(self.first, self.last)}"

    def _description(self) -> str:
        """Who moved, and how far. What is too large may have been larger: fringes tell it but for whole periods."""
        size = "about {:.2g} px or more" if self.is_too_large else _SIZE
        if not self.linear:
            size = f"more than {self.largest_px:.2g} projector pixels"
        return _likelier(self.motion, size) if self.undecided else moved_device(self.motion, size)


def largest_bump_px(finest_period: float) -> float:
    """The largest bump, in px, that can be taken back where fringes of this and longer periods tell of it."""
    return min(_LARGEST_CYCLES * finest_period, _LARGEST_PX)


def _likelier(motion: Floats, size: str) -> str:
    """In words, where either device explains a motion (8,): the likelier one first.

    A camera that moves is often taken for both; a projector that moves is not.
    """
    projector, camera = turns_px(motion)
    devices = ("camera", "projector") if camera >= _BOTH * projector else ("projector", "camera")
    return f"the {devices[0]}, or the {devices[1]}, moved by {size.format(max(projector, camera))}"


def turns_px(motion: Floats) -> tuple[float, float]:
    """By how many of its px the projector's picture moved, and the camera's."""
    projector, camera = (float(np.hypot(*part[:2])) for part in np.split(motion, [PER_DEVICE]))
    return projector, camera


def moved_device(motion: Floats, size: str = _SIZE) -> str:
    """In words, as in: the projector moved by 1.2 px; `motion` (8,) as in `rigid`, `size`: how px are told."""
    projector, camera = turns_px(motion)
    moved = [
        f"the {device} moved by {size.format(px)}"
        for device, px, other in (("projector", projector, camera), ("camera", camera, projector))
        if px >= _BOTH * other
    ]
    return " and ".join(moved)
