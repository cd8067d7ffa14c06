"""What is found out about captures."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from calib.geometry import Calibration, Matches
from calib.numerics import Image, Ints
from calib.pointcloud import Cloud, MergedCloud
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration
from scanner.capture import CaptureFacts
from scanner.decoding import Decoding


@dataclass
class Findings:
    """Of one capture. Filled in step by step; what a refusal prevented stays None.

    `calibration` is the one in use, with its scale; `truth` is known of simulated rigs, and only for showing it. `name`
    says in messages which of several captures it is; `photograph` is the lit scene where nothing was decoded; `plane`
    (N,) is which plane each match is on, as of `Faces`, where the faces were found and not given.
    """

    facts: CaptureFacts
    matches: Matches
    decoding: Decoding | None = None
    solution: SelfCalibration | None = None
    calibration: Calibration | None = None
    cloud: Cloud | None = None
    truth: Calibration | None = None
    name: str = ""
    photograph: Image | None = None
    plane: Ints | None = None

    @property
    def texture(self) -> Image | None:
        """The camera's image of the lit scene."""
        return self.decoding.texture if self.decoding else self.photograph

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know about the decoding and the calibration, in sentences."""
        return (*(self.decoding.warnings if self.decoding else ()), *(self.solution.notes if self.solution else ()))


@dataclass
class Scan:
    """Captures of one unchanged rig, oldest first; mostly it is only one."""

    captures: Sequence[Findings]
    merged: MergedCloud | None = None
    remarks_on_merging: tuple[str, ...] = ()

    @property
    def newest(self) -> Findings:
        """The capture that the result is about; the others help to calibrate it."""
        return self.captures[-1]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know about it, in sentences."""
        return (*self.newest.remarks, *self.remarks_on_merging)

    @property
    def titles(self) -> tuple[str, ...]:
        """The captures' numbers, as notes have them, and where they come from if they were not taken just now."""
        if self.newest.facts.photos:
            return tuple(found.name for found in self.captures)
        numbers = [f"Capture {number}" for number in range(1, len(self.captures) + 1)]
        return tuple(
            number if found.name in ("", number) else f"{number}: {found.name}"
            for number, found in zip(numbers, self.captures, strict=True)
        )

    @contextmanager
    def naming(self, found: Findings) -> Iterator[None]:
        """A RefusalError in the block says which of several captures it is about."""
        try:
            yield
        except RefusalError as refusal:
            if len(self.captures) == 1:
                raise
            raise RefusalError(f"{found.name}: {refusal.reason}", refusal.advice) from refusal
