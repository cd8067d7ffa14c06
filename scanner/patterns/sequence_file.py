"""How patterns are written in `capture.yaml` and `sequence.yaml`: a format that other programs read and write, such as

`{kind: gray, axis: x, bit: 0, bits: 10, cell: 1, offset: 0, inverted: false}`,
`{kind: xor, axis: x, bit: 0, bits: 10, base: 9, cell: 1, offset: 0, inverted: false}` and `{kind: phase, axis: x,
period: 16.0, shift: 0.0}`.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from calib.geometry import SQUARE_PIXELS, PixelGrid
from scanner.io import Entry, Flag, Number, Whole, flow_yaml, write_png
from scanner.patterns.pattern import Axis, Black, Gray, Pattern, Phase, White, Xor, draw

FORMAT = 1
# Height over width of the projector's pixels, in files whose patterns and size are told in square ones instead.
PIXEL_ASPECT_KEY = "pixel_aspect"
SEQUENCE_FILE = "sequence.yaml"


_KINDS: dict[str, type[Pattern]] = {kind.__name__.lower(): kind for kind in (White, Black, Gray, Xor, Phase)}


class _Shown(Entry):
    """The pattern of a frame: its fields, with the limits of what can be drawn and decoded."""

    kind: str

    def pattern(self) -> Pattern:
        """The pattern that the entry describes."""
        return _KINDS[self.kind](**self.model_dump(exclude={"kind"}))


class _PlainEntry(_Shown):
    kind: Literal["white", "black"]


class _BitEntry(_Shown):
    axis: Axis
    bit: Whole = Field(ge=0)
    bits: Whole = Field(ge=1, le=32)
    cell: Number = Field(ge=1, le=65536)
    offset: Number = Field(ge=0, le=2**32)
    inverted: Flag

    @field_validator("cell", "offset")
    @classmethod
    def _whole(cls, length: float) -> float:
        return int(length) if length.is_integer() else length

    @model_validator(mode="after")
    def _bit_exists(self) -> "_BitEntry":
        if self.bit >= self.bits:
            raise ValueError(f"bit must be less than bits, found bit {self.bit} of {self.bits}")
        return self


class _GrayEntry(_BitEntry):
    kind: Literal["gray"]


class _XorEntry(_BitEntry):
    kind: Literal["xor"]
    base: Whole = Field(ge=0)

    @model_validator(mode="after")
    def _base_is_another(self) -> "_XorEntry":
        if self.base >= self.bits or self.base == self.bit:
            raise ValueError(f"base must be another of the {self.bits} bits than bit {self.bit}, found {self.base}")
        return self


class _PhaseEntry(_Shown):
    """A fringe; a period of less than two pixels cannot be drawn."""

    kind: Literal["phase"]
    axis: Axis
    period: Number = Field(ge=2, le=1e6)
    shift: Number = Field(ge=-1e6, le=1e6)


PatternEntry = Annotated[_PlainEntry | _GrayEntry | _XorEntry | _PhaseEntry, Field(discriminator="kind")]


def pattern_to_dict(pattern: Pattern) -> dict[str, Any]:
    """A pattern in the form of the files."""
    return {"kind": type(pattern).__name__.lower(), **asdict(pattern)}


def frame_line(file: str, pattern: Pattern, **more: object) -> str:
    """One item of `frames`, as one line."""
    entry = {"file": file, "pattern": pattern_to_dict(pattern), **more}
    return f"  - {flow_yaml(entry)}\n"


def size_to_dict(size: tuple[int, int]) -> dict[str, int]:
    """(width, height) in the form of the files."""
    return {"width": size[0], "height": size[1]}


def aspect_to_dict(grid: PixelGrid) -> dict[str, float]:
    """The shape of the projector's pixels in the form of the files, unless they are square."""
    return {} if grid.aspect == 1 else {PIXEL_ASPECT_KEY: grid.aspect}


def write_sequence(
    folder: Path,
    patterns: tuple[Pattern, ...],
    projector_size: tuple[int, int],
    grid: PixelGrid = SQUARE_PIXELS,
    **more: object,
) -> None:
    """`sequence.yaml` and the images to project, `patterns/000.png` …, into an existing folder. Raises OSError.

    `projector_size` (width, height) is in square pixels, images in those of `grid`. `more`: further keys of
    `sequence.yaml`.
    """
    (folder / "patterns").mkdir()
    header = {"format": FORMAT, "projector": size_to_dict(projector_size), **aspect_to_dict(grid), **more}
    lines = [f"{flow_yaml(key)}: {flow_yaml(value)}\n" for key, value in header.items()] + ["frames:\n"]
    for index, pattern in enumerate(patterns):
        file = f"patterns/{index:03d}.png"
        write_png(folder / file, grid.sample(draw(pattern, projector_size)))
        lines.append(frame_line(file, pattern))
    (folder / SEQUENCE_FILE).write_text("".join(lines), encoding="utf-8")
