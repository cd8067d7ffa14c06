"""The named sequences, for any size of the projector. See docs/decoding.md."""

from dataclasses import asdict, dataclass
from typing import Literal

from scanner.patterns.pattern import Code, Pattern, sequence_for

PresetName = Literal["standard", "quick", "concave"]


@dataclass(frozen=True)
class Preset:
    """The arguments of `sequence_for`: a code down to `cell` px, fringes of `periods` px in `shifts` steps each."""

    code: Code
    cell: int
    inverses: bool
    periods: tuple[float, ...]
    shifts: int

    def patterns(self, projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
        """The sequence for a projector of (width, height)."""
        return sequence_for(projector_size, **asdict(self))


# Two periods whose ratio is far from simple fractions (1.382, or 2.39) seldom agree on a wrong fringe order, so that a
# wrong bit is detected. Deciding periods are not whole numbers of pixels: otherwise rounding to 256 grey levels would
# repeat in each cycle, and shift all coordinates by a thousandth of a pixel.
PRESETS: dict[PresetName, Preset] = {
    "standard": Preset("gray", cell=8, inverses=True, periods=(16.0, 6.7), shifts=4),
    "quick": Preset("gray", cell=8, inverses=False, periods=(12.3,), shifts=4),
    # Two codes that fail in different places, and fringes short enough to cancel in interreflection.
    "concave": Preset("both", cell=8, inverses=False, periods=(8.43, 6.1), shifts=4),
}
