"""Frame verification: groups of them that light every place alike together, or an even number of times, judged when all
that may show in them is known: the frames themselves, and those of the pictures that were on the wall beside them.
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
    """What some frames looked like before they were taken again, and what was on the wall beside their pictures."""

    frames: dict[int, Floats]
    beside: dict[int, set[int]]


class FrameVerification:
    """Of the frames of some pictures; groups are of numbers: `level` ones light every place alike together, `even` ones
    an even number of times (`hw/timing/parity_check.py`). `judged`: groups that can be judged and are not proven yet.
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
        """The largest share that is not told from noise."""
        return self._sums.tolerance

    def lacks(self, number: int) -> bool:
        """Whether a picture's group is not proven yet."""
        return number in self._unproven

    def are_together(self, number: int, others: Iterable[int]) -> bool:
        """Whether one of the others is in the group of a picture."""
        group = self._unproven.get(number, ())
        return any(other in group for other in others)

    def stood_beside(self, number: int, others: Iterable[int]) -> None:
        """These pictures were on the wall before and after that one, when it was last taken, pipelined."""
        self._beside[number] = {*others} - {number}

    def stood_in_row(self, numbers: Sequence[int], before: Collection[int]) -> None:
        """These pictures followed each other, each at rest when it was taken."""
        self.stood_beside(numbers[0], before)
        for number in numbers[1:]:
            self.stood_beside(number, ())
        for one, other in pairwise(numbers):
            self._beside[one] |= {other} - {one}
            self._beside[other] |= {one} - {other}

    def stood_alone(self, number: int) -> None:
        """Nothing else was on the wall, even if the picture came later than any."""
        self._beside[number] = set()

    def note(self, number: int, image: Image) -> None:
        """The frame that was taken of a picture."""
        self._seen[number] = self._sums.seen(image)

    def judge(self) -> None:
        """All groups that can be."""
        for group in dict.fromkeys(self._unproven.values()):
            if group not in self.judged and self._can_be_judged(group):
                self.judged.append(group)

    def foreign_share(self, group: Group) -> float:
        """Of a group, as it is now."""
        if self.is_even(group):
            return max([odd_share(group, self._seen), *(self._mixed_share(number) for number in group[1:])])
        pictures = [self._pictures[number] for number in group]
        return self._sums.foreign_share(group, pictures, self._seen, self._beside)

    def is_even(self, group: Group) -> bool:
        """Whether the group lights every place an even number of times."""
        return group in self._even

    def suspects(self, group: Group) -> Group:
        """Those frames of a group whose share of another picture is too large, if that can be told; else all."""
        if not self.is_even(group) or odd_share(group, self._seen) > self.tolerance:
            return group
        return tuple(number for number in group[1:] if self._mixed_share(number) > self.tolerance)

    def look(self, group: Group) -> Look:
        """Of frames, to be compared with what they look like when they have been taken again."""
        return Look(
            {number: self._seen[number] for number in group}, {number: self._beside[number] for number in group}
        )

    def is_as_before(self, look: Look) -> bool:
        """Whether the sum of frames does not depend on what was on the wall beside their pictures."""
        group = tuple(look.frames)
        pictures = [self._pictures[number] for number in group]
        either = {number: self._beside[number] | look.beside[number] for number in group}
        return self._sums.changed_share(group, pictures, look.frames, self._seen, either) <= self.tolerance

    def reopen(self, group: Group) -> None:
        """Forget its frames, for all of them are to be taken again, and to be judged then."""
        self.judged.remove(group)
        for number in group:
            del self._seen[number]

    def settle(self, group: Group) -> None:
        """The group is proven, as far as it can be; if nothing foreign is found but in frames beside it, when those are
        right it is judged anew.
        """
        self.judged.remove(group)
        if self.foreign_share(group) <= self.tolerance and not self._has_witnesses(group):
            return
        self._unproven = {number: of for number, of in self._unproven.items() if of != group}

    def _mixed_share(self, number: int) -> float:
        """Of a frame in an even group; where those beside it cannot tell, it counts as wrong. Rest proves nothing: a
        picture that came a refresh late was not there yet.
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
        """Whether the frames beside those of an even group, whose edges are looked for, are right themselves."""
        if not self.is_even(group):
            return True
        others = {self._unproven.get(other, group) for number in group for other in self._beside[number]} - {group}
        return all(self._is_told(other) and self.foreign_share(other) <= self.tolerance for other in others)
