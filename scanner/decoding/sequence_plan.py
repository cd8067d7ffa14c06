"""What a sequence of patterns measures: Gray codes and fringes per axis."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.numerics import Floats, Floats32, Ints, Words
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, Xor, draw

_MOST_NAMED = 12  # frames in a message
# This many of the finest bits may be blurred by projector, camera and scattering, or not resolved at all.
FINE_BITS = 3
# Parameters of a cosine: this many frames fit one in any order, including a wrong one.
COSINE_PARAMETERS = 3
# Mean difference of two patterns, relative to white, below which they look alike: two bits differ by a half, a dozen
# steps of a fringe by a sixth.
_ALIKE = 0.15
# Over fewer cycles the phases of a scene need not be uniformly distributed.
ENOUGH_CYCLES = 8.0


@dataclass(frozen=True)
class GrayCode:
    """The bits of one Gray code."""

    axis: Axis
    """Along which."""
    bits: int
    """Their number."""
    cell: float
    """Length of a cell in projector pixels."""
    offset: float
    """Projector pixels from the beginning of the code to pixel 0."""
    normal: Mapping[int, int]
    """Index of the frame that shows a bit, by bit."""
    inverse: Mapping[int, int]
    """The same of inverted bits."""
    constant: int = 0
    """Bits of the code word that were not shown because they are constant on this projector."""
    base: int | None = None
    """The bit with which the relative ones are combined by exclusive or (an XOR code); None for a plain Gray code."""
    relative: frozenset[int] = frozenset()
    """Bits that are shown relative to the base."""

    def relative_to_base(self, words: Words) -> Words:
        """Convert words of an XOR code to the plain code, and the reverse; any shape."""
        if self.base is None:
            return words
        relative = sum(1 << self.bits - 1 - bit for bit in self.relative)
        base = words >> words.dtype.type(self.bits - 1 - self.base) & words.dtype.type(1)
        return words ^ base * words.dtype.type(relative)

    def without_finest(self, count: int) -> "GrayCode":
        """Return the code of longer cells without its `count` finest bits."""
        bits = self.bits - count
        normal, inverse = ({b: f for b, f in frames.items() if b < bits} for frames in (self.normal, self.inverse))
        constant = self.constant >> count
        return replace(self, bits=bits, cell=self.cell * 2**count, normal=normal, inverse=inverse, constant=constant)

    @property
    def pairs(self) -> dict[int, tuple[int, int]]:
        """Bit → frames of the pattern and its inverse, for the bits that have both."""
        return {bit: (self.normal[bit], self.inverse[bit]) for bit in self.normal if bit in self.inverse}

    @property
    def unpaired(self) -> dict[int, int]:
        """Bit → its only frame, either the pattern or the inverse."""
        alone = {bit: frame for bit, frame in self.normal.items() if bit not in self.inverse}
        return alone | {bit: frame for bit, frame in self.inverse.items() if bit not in self.normal}

    @property
    def frames(self) -> list[int]:
        """All frames, in order."""
        return sorted([*self.normal.values(), *self.inverse.values()])

    @property
    def fine_frames(self) -> list[int]:
        """The frames of the finest bits and of their inverses."""
        return self.frames_of(range(self.bits - FINE_BITS, self.bits))

    def frames_of(self, bits: Iterable[int]) -> list[int]:
        """Return the frames of some bits and of their inverses."""
        return [frames[bit] for bit in bits for frames in (self.normal, self.inverse) if bit in frames]


@dataclass(frozen=True)
class Fringe:
    """One period in all its shifts."""

    axis: Axis
    """Along which."""
    period: float
    """In projector pixels."""
    shifts: tuple[float, ...]
    """In cycles, in the order of the frames."""
    frames: tuple[int, ...]
    """Their indices."""

    @cached_property
    def weights(self) -> Floats:
        """(3, N): least squares of offset, a cos θ and a sin θ in I = offset + a cos(θ + 2π shift)."""
        return np.linalg.pinv(self.design).astype(np.float64)

    @cached_property
    def weights32(self) -> Floats32:
        """(2, N): those of a cos θ and a sin θ, in single precision; half of those of four equal shifts are 0."""
        return np.round(self.weights[1:], 9).astype(np.float32)

    @cached_property
    def design(self) -> Floats:
        """(N, 3): derivatives of I by offset, a cos θ and a sin θ."""
        angles = 2 * np.pi * np.array(self.shifts)
        return np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)

    @cached_property
    def noise_gain(self) -> float:
        """Standard deviation of the fringe's two components per grey level of noise; √(2/N) for equal shifts."""
        return float(np.sqrt(np.mean(np.sum(self.weights[1:] ** 2, axis=1))))

    @cached_property
    def equal_steps(self) -> bool:
        """Whether the shifts divide the cycle evenly, so that only harmonics next to multiples of N
        distort the phase.
        """
        steps = np.diff(np.sort(np.mod(np.array(self.shifts) + 1e-9, 1)))
        return bool(np.allclose(steps, 1 / len(self.shifts), atol=1e-6))


@dataclass(frozen=True)
class AxisPlan:
    """How one projector coordinate is measured."""

    axis: Axis
    """Which."""
    length: int
    """Of the projector's picture along it, in pixels."""
    codes: tuple[GrayCode, ...]
    """Along it."""
    fringes: tuple[Fringe, ...]
    """From the longest period to the shortest."""

    @property
    def is_measured(self) -> bool:
        """Whether any pattern varies along it."""
        return bool(self.codes or self.fringes)

    @property
    def cell(self) -> float:
        """The length within which the Gray codes do not determine the coordinate."""
        return min((code.cell for code in self.codes), default=self.length)

    @property
    def corrects_bits(self) -> bool:
        """Whether a second fringe period detects wrong bits of the Gray code."""
        return len(self.fringes) > 1

    @property
    def is_unchecked(self) -> bool:
        """Whether nothing checks the systematic phase error: one fringe of too few cycles to show it."""
        return len(self.fringes) == 1 and self.length < ENOUGH_CYCLES * self.fringes[0].period

    @property
    def frames(self) -> list[int]:
        """All frames of this axis, in order."""
        of_codes = [frame for code in self.codes for frame in code.frames]
        return sorted({*of_codes, *(frame for fringe in self.fringes for frame in fringe.frames)})


@dataclass(frozen=True)
class SequencePlan:
    """The whole sequence. Frames are counted as one per pattern."""

    patterns: tuple[Pattern, ...]
    """Each once."""
    x: AxisPlan
    """How x is measured."""
    y: AxisPlan
    """How y is measured."""
    white: int | None
    """Index of the white frame; None without one."""
    black: int | None
    """Index of the black frame; None without one."""
    shown: tuple[int, ...]
    """The pattern of each frame; a repeated pattern shows what has changed since."""
    repeats: int = 1
    """Number of exposures of each."""

    @property
    def frame_count(self) -> int:
        """The number of frames of the capture."""
        return self.repeats * len(self.shown)

    @property
    def axes(self) -> tuple[AxisPlan, AxisPlan]:
        """Both axes."""
        return self.x, self.y

    @property
    def only_axis(self) -> AxisPlan | None:
        """The measured axis, if only one is measured."""
        return None if self.x.is_measured and self.y.is_measured else self.x if self.x.is_measured else self.y

    @property
    def codes(self) -> tuple[GrayCode, ...]:
        """The Gray codes of both axes."""
        return self.x.codes + self.y.codes

    @property
    def fringes(self) -> tuple[Fringe, ...]:
        """The fringes of both axes."""
        return self.x.fringes + self.y.fringes

    @property
    def fringe_frames(self) -> list[int]:
        """The frames of all fringes."""
        return [frame for fringe in self.fringes for frame in fringe.frames]

    @property
    def complements(self) -> list[tuple[int, int]]:
        """Pairs of frames whose light adds up to white plus black: patterns with inverses, and white with black."""
        pairs = [*dict.fromkeys(pair for code in self.codes for pair in code.pairs.values())]
        if self.white is not None and self.black is not None:
            pairs.append((self.white, self.black))
        return pairs

    def shows_the_same(self, frame: int, second: int) -> bool:
        """Whether two patterns are nearly the same picture, such as white and a bit that is 1 on most of the projector.

        If only part of the picture is visible, they may be identical there.
        """
        size = self.x.length, self.y.length
        first, two = (draw(self.patterns[number], size).astype(np.int16) for number in (frame, second))
        return float(np.abs(first - two).mean()) < _ALIKE * np.iinfo(np.uint8).max

    def times_of(self, fringe: Fringe) -> tuple[Ints, Floats]:
        """Return the places (N,) at which the steps of a fringe are shown, with repeats, and the shifts (N,) there."""
        taken = [
            (time, shift)
            for shift, frame in zip(fringe.shifts, fringe.frames, strict=True)
            for time, number in enumerate(self.shown)
            if number == frame
        ]
        return np.array([time for time, _ in taken]), np.array([shift for _, shift in taken])

    def name(self, frame: int) -> str:
        """Return a frame's number and pattern, for messages."""
        number = self.shown.index(frame) * self.repeats
        return f"frame {number} ({describe(self.patterns[frame])})"

    def names(self, frames: Sequence[int]) -> str:
        """Return several frames' numbers and patterns, for messages."""
        chosen = sorted(set(frames))
        listed = ", ".join(self.name(frame) for frame in chosen[:_MOST_NAMED])
        return listed if len(chosen) <= _MOST_NAMED else f"{listed} and {len(chosen) - _MOST_NAMED} more"


def describe(pattern: Pattern) -> str:
    """Return a pattern in a few words."""
    match pattern:
        case White():
            return "white"
        case Black():
            return "black"
        case Gray():
            return f"gray {pattern.axis} bit {pattern.bit}{' inverted' if pattern.inverted else ''}"
        case Xor():
            return f"xor {pattern.axis} bit {pattern.bit} base {pattern.base}{' inverted' if pattern.inverted else ''}"
        case Phase():
            return f"phase {pattern.axis} period {pattern.period:g} shift {pattern.shift:g}"
