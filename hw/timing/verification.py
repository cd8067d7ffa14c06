"""Frame verification in groups, by complementary sums or parity.

A group is judged once its frames are known, and those of the pictures that were on the wall before and after them.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from calib.numerics import Floats, Image
from hw.timing.complementary_sums import ComplementarySums
from hw.timing.numbered_pictures import NumberedPictures
from hw.timing.parity_check import mixed_share, odd_share

Group = tuple[int, ...]


@dataclass(frozen=True)
class Look:
    """Frames before they are repeated, and the pictures that were on the wall before and after each."""

    frames: dict[int, Floats]
    beside: dict[int, set[int]]


class FrameVerification:
    """Verifies frames in groups of picture numbers: `level` groups sum to uniform light, `even` groups light every
    place an even number of times (`hw/timing/parity_check.py`). `judged`: groups that can be judged and are still open.
    """

    def __init__(
        self,
        sums: ComplementarySums,
        pictures: NumberedPictures,
        level: Iterable[Sequence[int]],
        even: Iterable[Sequence[int]] = (),
    ) -> None:
        self._sums = sums
        self._pictures = pictures
        self._even = frozenset(map(tuple, even))
        self._unproven = {number: tuple(group) for group in [*level, *self._even] for number in group}
        self._seen: dict[int, Floats] = {}
        self._beside: dict[int, set[int]] = {}
        self.judged: list[Group] = []

    @property
    def tolerance(self) -> float:
        """The largest share of another picture that cannot be distinguished from noise."""
        return self._sums.tolerance

    def lacks(self, number: int) -> bool:
        """Whether a picture's group still has to be verified."""
        return number in self._unproven

    def are_together(self, number: int, others: Iterable[int]) -> bool:
        """Whether one of the others is in the same group as a picture."""
        group = self._unproven.get(number, ())
        return any(other in group for other in others)

    def stood_beside(self, number: int, others: Iterable[int]) -> None:
        """Record the pictures before and after a pipelined picture, when it was last taken."""
        self._beside[number] = {*others} - {number}

    def stood_in_row(self, numbers: Sequence[int], before: Collection[int]) -> None:
        """Record that these pictures followed each other, each taken at rest."""
        self.stood_beside(numbers[0], before)
        for number in numbers[1:]:
            self.stood_beside(number, ())
        for one, other in pairwise(numbers):
            self._beside[one] |= {other} - {one}
            self._beside[other] |= {one} - {other}

    def stood_alone(self, number: int) -> None:
        """Record that no other picture can have been on the wall."""
        self._beside[number] = set()

    def note(self, number: int, image: Image) -> None:
        """Record the frame of a picture."""
        self._seen[number] = self._sums.seen(image)

    def judge(self) -> None:
        """Add all groups that can be judged now to `judged`."""
        for group in dict.fromkeys(self._unproven.values()):
            if group not in self.judged and self._can_be_judged(group):
                self.judged.append(group)

    def foreign_share(self, group: Group) -> float:
        """The share of other pictures in the present frames of a group."""
        if self.is_even(group):
            return max([odd_share(group, self._seen), *(self._mixed_share(number) for number in group[1:])])
        pictures = [self._pictures[number] for number in group]
        return self._sums.foreign_share(group, pictures, self._seen, self._beside)

    def is_even(self, group: Group) -> bool:
        """Whether the group lights every place an even number of times."""
        return group in self._even

    def suspects(self, group: Group) -> Group:
        """The frames of a group whose share of another picture is too large, if they are known; otherwise all."""
        if not self.is_even(group) or odd_share(group, self._seen) > self.tolerance:
            return group
        return tuple(number for number in group[1:] if self._mixed_share(number) > self.tolerance)

    def look(self, group: Group) -> Look:
        """Keep the present frames, to compare them with the repeated ones."""
        return Look(
            {number: self._seen[number] for number in group}, {number: self._beside[number] for number in group}
        )

    def is_as_before(self, look: Look) -> bool:
        """Whether repeated frames look the same, whatever was on the wall before and after them."""
        group = tuple(look.frames)
        pictures = [self._pictures[number] for number in group]
        either = {number: self._beside[number] | look.beside[number] for number in group}
        return self._sums.changed_share(group, pictures, look.frames, self._seen, either) <= self.tolerance

    def reopen(self, group: Group) -> None:
        """Forget the frames of a group, because all are repeated and judged again."""
        self.judged.remove(group)
        for number in group:
            del self._seen[number]

    def settle(self, group: Group) -> None:
        """Close a group. It stays open if only neighbouring frames are wrong, and is judged again after those."""
        self.judged.remove(group)
        if self.foreign_share(group) <= self.tolerance and not self._has_witnesses(group):
            return
        self._unproven = {number: of for number, of in self._unproven.items() if of != group}

    def _mixed_share(self, number: int) -> float:
        """The share of other pictures in a frame of an even group; 1 if the neighbouring frames do not determine it.

        Frames at rest are checked as well: a picture may have arrived a refresh late.
        """
        beside = sorted(self._beside[number])
        if not beside:
            return 0.0
        if not self._seen.keys() >= {*beside}:
            return 1.0
        share = mixed_share(self._seen[number], [self._seen[other] for other in beside], self.tolerance)
        return 1.0 if share is None else share

    def _can_be_judged(self, group: Group) -> bool:
        return self._is_told(group) and (self.foreign_share(group) > self.tolerance or self._has_witnesses(group))

    def _is_told(self, group: Group) -> bool:
        return all(number in self._seen and self._beside[number] <= self._seen.keys() for number in group)

    def _has_witnesses(self, group: Group) -> bool:
        """Whether the neighbouring frames of an even group, whose edges are used, are verified themselves."""
        if not self.is_even(group):
            return True
        others = {self._unproven.get(other, group) for number in group for other in self._beside[number]} - {group}
        return all(self._is_told(other) and self.foreign_share(other) <= self.tolerance for other in others)
