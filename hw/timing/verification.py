"""Frame verification in groups, by complementary sums or parity.

A group is judged once its frames are known, and those of the pictures that were on the wall before and after them.
Frames of black and white at rest are the reference.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np

from calib.numerics import Bools, Floats, Image, grey
from hw.cameras import NamedCamera
from hw.errors import DeviceError, OverexposedError
from hw.rig import Frame
from hw.timing.redundancy import ComplementarySums, complementary_sums, mixed_share, odd_share

_LEAST_TOLERANCE = 0.005  # share of the light: with a fringe of 16 px in 8 steps, a hundredth of a projector pixel
_BANDS = 8  # of the image, from top to bottom
_CLIPPED = 254 / 255  # of the highest level; demosaicing mixes clipped pixels with others


class RestingLight:
    """Finds the lit pixels and their levels, from three or more frames each of black and of white.

    `tolerance`: the smallest share of the light that exceeds noise. Raises DeviceError if the camera sees no
    difference, OverexposedError if all lit pixels are clipped.
    """

    def __init__(self, camera: NamedCamera, dark: Sequence[Image], bright: Sequence[Image]) -> None:
        self.lit = _lit_pixels(camera, dark, bright)
        levels = np.array([[self._levels(image) for image in images] for images in (dark, bright)])
        self._dark, self._bright = levels.mean(axis=1)
        noise = np.max(np.ptp(levels, axis=1) / (self._bright - self._dark))
        self.tolerance = max(_LEAST_TOLERANCE, 3.0 * float(noise))
        self.sums: ComplementarySums = complementary_sums(dark, bright, self.lit, self.tolerance)

    def missing(self, image: Image, target: int) -> Floats:
        """The missing share (B,) of the change to `target` (0 black, 1 white) in each band of rows: 1 before it
        begins, 0 at rest.
        """
        share = (self._levels(image) - self._dark) / (self._bright - self._dark)
        missing: Floats = 1 - share if target == 1 else share
        return missing

    def _levels(self, image: Image) -> Floats:
        """Mean brightness (B,) of the lit pixels in bands of rows, from top to bottom."""
        lit = grey(image)[self.lit]
        return np.array([part.mean() for part in np.array_split(lit, min(_BANDS, len(lit)))])


def _lit_pixels(camera: NamedCamera, dark: Sequence[Image], bright: Sequence[Image]) -> Bools:
    """Pixels that white lights well without clipping them, (H, W)."""
    contrast = grey(np.mean(bright, axis=0)) - grey(np.mean(dark, axis=0))
    noise = np.std(grey(dark[1]) - grey(dark[0]))
    strong = float(np.percentile(contrast, 99))
    if strong < 6 * noise or strong <= 0:
        raise DeviceError(
            f"camera {camera.name}: it sees no difference between a white and a black picture. Check lens "
            "cap, aperture and exposure, that the projector is on and shows this screen, then rerun."
        )
    clipped = np.max(bright, axis=0) >= camera.highest_level * _CLIPPED
    if clipped.ndim == 3:
        clipped = clipped.any(axis=2)
    lit: Bools = (contrast > strong / 2) & ~clipped
    if not lit.any():
        raise OverexposedError(
            f"camera {camera.name}: everything that white lights is overexposed. Close the aperture, lower "
            "the rig's gain or exposure_us, then rerun."
        )
    return lit


T = TypeVar("T")
Group = tuple[int, ...]
Levels = dict[int, Floats]  # the brightness of a camera's frames, by picture number


class NumberedPictures:
    """Reads pictures, numbered from 0, on demand, and keeps them until `forget`."""

    def __init__(self, images: Iterator[Image]) -> None:
        self._images = images
        self._known: dict[int, Image] = {}
        self._count = 0
        self._ended = False

    def __getitem__(self, number: int) -> Image:
        return self._known[number]

    def has(self, number: int) -> bool:
        """Whether there is a picture with this number."""
        while self._count <= number and not self._ended:
            image = next(self._images, None)
            if image is None:
                self._ended = True
            else:
                self._known[self._count] = image
                self._count += 1
        return number < self._count

    def forget(self, before: int) -> None:
        """Drop the pictures with smaller numbers."""
        for number in [known for known in self._known if known < before]:
            del self._known[number]


@dataclass(frozen=True)
class FrameSnapshot:
    """Frames of each camera before they are repeated, and the pictures on the wall before and after each."""

    frames: tuple[Levels, ...]
    neighbours: dict[int, set[int]]


class FrameVerification:
    """Verifies frames of one camera or several, for each of which there is one of `sums`.

    Frames form groups of picture numbers: `level` groups sum to uniform light, `even` groups light every
    place an even number of times (`hw/timing/redundancy.py`). `judged`: groups that can be judged and are still open.
    """

    def __init__(
        self,
        sums: Sequence[ComplementarySums],
        pictures: NumberedPictures,
        level: Iterable[Sequence[int]],
        even: Iterable[Sequence[int]] = (),
    ) -> None:
        self._cameras: tuple[tuple[ComplementarySums, Levels], ...] = tuple((camera_sums, {}) for camera_sums in sums)
        self._pictures = pictures
        self._even = frozenset(map(tuple, even))
        self._unverified = {number: tuple(group) for group in [*level, *self._even] for number in group}
        self._neighbours: dict[int, set[int]] = {}
        self.judged: list[Group] = []

    def lacks(self, number: int) -> bool:
        """Whether a picture's group still has to be verified."""
        return number in self._unverified

    def are_together(self, number: int, numbers: Iterable[int]) -> bool:
        """Whether one of the others is in the same group as a picture."""
        group = self._unverified.get(number, ())
        return any(member in group for member in numbers)

    def set_neighbours(self, number: int, neighbours: Iterable[int]) -> None:
        """Record the pictures before and after a pipelined picture, when it was last taken."""
        self._neighbours[number] = {*neighbours} - {number}

    def set_sequence(self, numbers: Sequence[int], before: Collection[int]) -> None:
        """Record that these pictures followed each other, each taken at rest."""
        self.set_neighbours(numbers[0], before)
        for number in numbers[1:]:
            self.set_neighbours(number, ())
        for earlier, later in pairwise(numbers):
            self._neighbours[earlier] |= {later} - {earlier}
            self._neighbours[later] |= {earlier} - {later}

    def clear_neighbours(self, number: int) -> None:
        """Record that no other picture can have been on the wall."""
        self._neighbours[number] = set()

    def note(self, number: int, frames: Sequence[Frame]) -> None:
        """Record the frames of a picture, one of each camera."""
        for (sums, levels), frame in zip(self._cameras, frames, strict=True):
            levels[number] = sums.brightness(frame.image)

    def judge(self) -> None:
        """Add all groups that can be judged now to `judged`."""
        for group in dict.fromkeys(self._unverified.values()):
            if group not in self.judged and self._can_be_judged(group):
                self.judged.append(group)

    def foreign(self, group: Group) -> float:
        """The share of other pictures in the present frames of a group, relative to the largest that cannot be
        distinguished from noise in their camera; the largest of all cameras. The frames pass if it is at most 1.
        """
        return self._worst(self._foreign_share, group)

    def is_even(self, group: Group) -> bool:
        """Whether the group lights every place an even number of times."""
        return group in self._even

    def suspects(self, group: Group) -> Group:
        """The frames of a group whose share of another picture is too large, if they are known; otherwise all."""
        if not self.is_even(group) or self._worst(_odd_share, group) > 1:
            return group
        return tuple(number for number in group[1:] if self._worst(self._mixed_share, number) > 1)

    def snapshot(self, group: Group) -> FrameSnapshot:
        """Keep the present frames, to compare them with the repeated ones."""
        frames = tuple({number: levels[number] for number in group} for _, levels in self._cameras)
        return FrameSnapshot(frames, {number: self._neighbours[number] for number in group})

    def is_unchanged(self, snapshot: FrameSnapshot) -> bool:
        """Whether repeated frames look the same, whatever was on the wall before and after them."""
        group = tuple(snapshot.neighbours)
        pictures = [self._pictures[number] for number in group]
        either = {number: self._neighbours[number] | snapshot.neighbours[number] for number in group}
        return all(
            sums.changed_share(group, pictures, before, levels, either) <= sums.tolerance
            for before, (sums, levels) in zip(snapshot.frames, self._cameras, strict=True)
        )

    def reopen(self, group: Group) -> None:
        """Forget the frames of a group, because all are repeated and judged again."""
        self.judged.remove(group)
        for _, levels in self._cameras:
            for number in group:
                del levels[number]

    def settle(self, group: Group) -> None:
        """Close a group. It stays open if only neighbouring frames are wrong, and is judged again after those."""
        self.judged.remove(group)
        if self.foreign(group) <= 1 and not self._are_neighbours_verified(group):
            return
        self._unverified = {number: of for number, of in self._unverified.items() if of != group}

    def _worst(self, share: Callable[[T, ComplementarySums, Levels], float], of: T) -> float:
        """The largest share of all cameras, relative to the tolerance of each."""
        return max(share(of, sums, levels) / sums.tolerance for sums, levels in self._cameras)

    def _foreign_share(self, group: Group, sums: ComplementarySums, levels: Levels) -> float:
        if self.is_even(group):
            mixed = [self._mixed_share(number, sums, levels) for number in group[1:]]
            return max([odd_share(group, levels), *mixed])
        return sums.foreign_share(group, [self._pictures[number] for number in group], levels, self._neighbours)

    def _mixed_share(self, number: int, sums: ComplementarySums, levels: Levels) -> float:
        """The share of other pictures in a frame of an even group; 1 if the neighbouring frames do not determine it.

        Frames at rest are checked as well: a picture may have arrived a refresh late.
        """
        neighbours = sorted(self._neighbours[number])
        if not neighbours:
            return 0.0
        if not levels.keys() >= {*neighbours}:
            return 1.0
        share = mixed_share(levels[number], [levels[neighbour] for neighbour in neighbours], sums.tolerance)
        return 1.0 if share is None else share

    def _can_be_judged(self, group: Group) -> bool:
        return self._is_complete(group) and (self.foreign(group) > 1 or self._are_neighbours_verified(group))

    def _is_complete(self, group: Group) -> bool:
        levels = self._cameras[0][1].keys()
        return all(number in levels and self._neighbours[number] <= levels for number in group)

    def _are_neighbours_verified(self, group: Group) -> bool:
        """Whether the neighbouring frames of an even group, whose edges are used, are verified themselves."""
        if not self.is_even(group):
            return True
        groups = {
            self._unverified.get(neighbour, group) for number in group for neighbour in self._neighbours[number]
        } - {group}
        return all(
            self._is_complete(neighbour_group) and self.foreign(neighbour_group) <= 1 for neighbour_group in groups
        )


def _odd_share(group: Group, _: ComplementarySums, levels: Levels) -> float:
    return odd_share(group, levels)
