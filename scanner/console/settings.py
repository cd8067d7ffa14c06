"""The operator's settings on the page."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.networks import Pair
from scanner.patterns import Black, Pattern, Phase, White, draw
from scanner.results import default_out

_LONGEST_NAME = 80


class IdlePicture(StrEnum):
    """What the projector shows between scans."""

    WHITE = "White"
    BLACK = "Black"
    STRIPES = "Stripes"


@dataclass(frozen=True)
class ConsoleSettings:
    """The configuration's file and overrides, and on top of them what was changed on the page; None: left as it is.

    `name`: of the next result; '' for the configuration's. `captures`: how many a scan takes.
    `calibration`: of the rig, for live clouds; None for the newest result's. Of a network, `pair` is the camera and the
    projector that are looked at, checked and scanned with, None for all cameras in turn; `distance` is known between
    two devices, as in left,stage,2.35m.
    """

    config: Path
    overrides: tuple[str, ...] = ()
    exposure_us: float | None = None
    gain: float | None = None
    picture: IdlePicture = IdlePicture.WHITE
    name: str = ""
    captures: int = 1
    calibration: Path | None = None
    pair: Pair | None = None
    distance: str = ""

    @property
    def rig_key(self) -> str:
        """The section of the configuration with the exposure of what is looked at."""
        return "rig" if self.pair is None else f"rigs.cameras.{self.pair[0]}.rig"

    def load_whole(self) -> Config:
        """The configuration as it is now, also if the file was edited meanwhile. Raises InputError."""
        whole = load_config(self.config, self.overrides)
        set_here = {"exposure_us": self.exposure_us, "gain": self.gain}
        changed = [f"{key}={value!r}" for key, value in set_here.items() if value is not None]
        if not changed:
            return whole
        sections = [self.rig_key]
        if whole.rigs is not None and self.pair is None:
            sections = [f"rigs.cameras.{camera}.rig" for camera in whole.rigs.cameras]
        return load_config(
            self.config, [*self.overrides, *(f"{section}.{key}" for section in sections for key in changed)]
        )

    def load(self) -> Config:
        """The same, or of a network that of the pair. Raises InputError, also if no pair is chosen."""
        whole = self.load_whole()
        if whole.rigs is None:
            return whole
        if self.pair is None:
            raise InputError(f"{self.config} names several devices: choose a camera and a projector, or press Network")
        pairs = whole.pairs
        if self.pair not in pairs:
            raise InputError(f"{self.config} names no camera {self.pair[0]} with a projector {self.pair[1]} any more")
        return pairs[self.pair]

    def in_turn(self) -> tuple["ConsoleSettings", ...]:
        """What to look at: the rig or the pair, or else each camera of a network in the first projector's light."""
        rigs = self.load_whole().rigs
        if rigs is None or self.pair is not None:
            return (self,)
        projector = next(iter(rigs.projectors))
        return tuple(replace(self, pair=(camera, projector)) for camera in rigs.cameras)

    def destination(self, ending: str = "") -> Path:
        """Return the next result's folder: a new one in scans/, named as typed or else after the configuration."""
        return default_out((self.name or self.config.stem) + ending, overwrite=False)


def plain_name(text: str) -> str:
    """Reduce typed text to a folder name of letters, digits and dashes; '' if none remain."""
    return re.sub(r"[^\w.-]+", "-", text).strip("-.")[:_LONGEST_NAME]


def drawn(picture: IdlePicture, sequence: Iterable[Pattern], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Draw what to project, (H, W) for a projector of `size` (width, height). The stripes are the finest of the
    sequence.
    """
    match picture:
        case IdlePicture.WHITE:
            return draw(White(), size)
        case IdlePicture.BLACK:
            return draw(Black(), size)
        case IdlePicture.STRIPES:
            return draw(_finest(sequence), size)


def _finest(sequence: Iterable[Pattern]) -> Pattern:
    patterns = list(sequence)
    fringes = [pattern for pattern in patterns if isinstance(pattern, Phase)]
    return min(fringes, key=lambda fringe: fringe.period) if fringes else patterns[-1]
