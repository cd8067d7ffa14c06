"""What proves frames: groups of them that light every place alike together, judged when all that may show in them is
known: the frames themselves, and those of the pictures that were on the wall beside them.
"""

from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise

from calib.numerics import Floats, Image
from hw.level_sums import LevelSums
from hw.numbered_pictures import NumberedPictures

Group = tuple[int, ...]
# What a group looked like before it was taken again, and beside what.
Look = tuple[dict[int, Floats], dict[int, set[int]]]


class Proofs:
    """Of the frames of some pictures; `groups` are of numbers. `judged`: which share of a frame is of another picture,
    of groups that are not proven yet.
    """

    def __init__(self, sums: LevelSums, pictures: NumberedPictures, groups: Iterable[Sequence[int]]) -> None:
        self._sums = sums
        self._pictures = pictures
        self._unproven = {number: tuple(group) for group in groups for number in group}
        self._seen: dict[int, Floats] = {}
        self._beside: dict[int, set[int]] = {}
        self.judged: dict[Group, float] = {}

    @property
    def tolerance(self) -> float:
        """The largest share that is not told from noise."""
        return self._sums.tolerance

    def lacks(self, number: int) -> bool:
        """Whether a picture's group is not proven yet."""
        return number in self._unproven

    def stood_beside(self, number: int, others: Iterable[int]) -> None:
        """These pictures were on the wall before and after that one, when it was last taken."""
        self._beside[number] = {*others} - {number}

    def stood_in_row(self, numbers: Sequence[int], before: Collection[int]) -> None:
        """These pictures followed each other."""
        self.stood_beside(numbers[0], before)
        for number in numbers[1:]:
            self.stood_beside(number, ())
        for one, other in pairwise(numbers):
            self._beside[one].add(other)
            self._beside[other].add(one)

    def note(self, number: int, image: Image) -> None:
        """The frame that was taken of a picture."""
        self._seen[number] = self._sums.seen(image)

    def judge(self) -> None:
        """All groups that can be."""
        for group in dict.fromkeys(self._unproven.values()):
            if group not in self.judged and all(self._is_told(number) for number in group):
                self.judged[group] = self.foreign_share(group)

    def foreign_share(self, group: Group) -> float:
        """Of a group, as it is now."""
        pictures = [self._pictures[number] for number in group]
        return self._sums.foreign_share(group, pictures, self._seen, self._beside)

    def look(self, group: Group) -> Look:
        """Of a group, to be compared with what it looks like when it has been taken again."""
        return {number: self._seen[number] for number in group}, {number: self._beside[number] for number in group}

    def is_as_before(self, group: Group, look: Look) -> bool:
        """Whether a group's sum does not depend on what was on the wall beside its pictures."""
        before, beside = look
        either = {number: self._beside[number] | beside[number] for number in group}
        return self._sums.changed_share(group, before, self._seen, either) <= self.tolerance

    def settle(self, group: Group) -> None:
        """The group is proven, as far as it can be."""
        self.judged.pop(group, None)
        self._unproven = {number: of for number, of in self._unproven.items() if of != group}

    def _is_told(self, number: int) -> bool:
        return number in self._seen and self._beside[number] <= self._seen.keys()
