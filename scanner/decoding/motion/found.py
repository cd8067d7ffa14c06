"""What was found of a motion of camera or projector during a capture, and what it did to the coordinates."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from scanner.decoding.motion.rigid import PER_DEVICE, shifts_by_motion

# More than this breaks fringes, so that single matches err; of a slow motion, each fringe sees a part only.
_LARGEST_BUMP_PX = 0.5
_LARGEST_DRIFT_PX = 3.0
# A cause counts as well if it moves the coordinates by this share of what the larger one does.
_BOTH = 0.5


@dataclass(frozen=True)
class Disturbance:
    """A `motion` (8,) of the devices, as in `rigid`, of which x and y have taken part in other `shares` (2,).

    Sizes of the images, (width, height).
    """

    motion: Floats
    shares: Floats
    camera_size: tuple[int, int]
    projector_size: tuple[int, int]

    def shifts(self, camera_px: Floats, projector_px: Floats, gradient: Floats) -> Floats:
        """By how much it has shifted the coordinates of matches (N, 2), (N, 2), against each other.

        `gradient` (N, 2, 2): of the projector's coordinates (rows) by camera x and y.
        """
        by_motion = shifts_by_motion(camera_px, projector_px, gradient, self.camera_size, self.projector_size)
        shifts: Floats = self.shares * (by_motion @ self.motion)
        return shifts


@dataclass(frozen=True)
class MotionFound:
    """The motion that explains the fringes of a capture best.

    `significant`: it is more than what is found at rest. `slow`: even, all the time; else at once, between the frames
    `first` and `last`. `size_px`: how far it moved the coordinates. `explained`: the share that it explains of what
    contradicts rest. `shift`: what it did to the coordinates; `others`: the same by courses that explain it about as
    well. `witnessed`: a motion between the axes would have been seen.
    """

    significant: bool
    slow: bool
    first: int
    last: int
    size_px: float
    explained: float
    shift: Disturbance
    others: tuple[Disturbance, ...]
    witnessed: bool

    @property
    def is_too_large(self) -> bool:
        """Whether single matches can no longer be trusted."""
        return self.significant and self.size_px > (_LARGEST_DRIFT_PX if self.slow else _LARGEST_BUMP_PX)

    def __str__(self) -> str:
        """In words, as in: the projector moved by 1.2 px between frames 18 and 24."""
        projector, camera = (float(np.hypot(*part[:2])) for part in np.split(self.shift.motion, [PER_DEVICE]))
        moved = [
            f"the {device} moved by {px:.2g} px"
            for device, px, other in (("projector", projector, camera), ("camera", camera, projector))
            if px >= _BOTH * other
        ]
        when = "slowly, from frame {} to {}" if self.slow else "between frames {} and {}"
        return f"{' and '.join(moved)} {when.format(self.first, self.last)}"
