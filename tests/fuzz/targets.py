"""All targets by name. Each creates its files in a folder and returns a function of random numbers."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz import commands, other_files, pictures, programs, readers
from tests.fuzz.guarded import Run, guarded
from tests.fuzz.mutations import Random

_MADE_IN = (
    *(readers.capture, readers.configuration, readers.calibration, readers.matches, readers.cloud, readers.poses),
    *(
        readers.surfaces,
        readers.room,
        readers.network,
        readers.steps,
        readers.imports,
        pictures.masks,
        pictures.photos,
        programs.results,
        programs.calibrating,
    ),
    *(
        commands.board,
        commands.batch,
        other_files.refusal,
        other_files.log,
        other_files.row,
        other_files.left_behind,
        other_files.compared,
    ),
    *(other_files.asked,),
)
TARGETS: dict[str, Callable[[Path], Run]] = {
    **{make.__name__: make for make in _MADE_IN},
    **{f"image{suffix}": pictures.image(suffix) for suffix in pictures.FORMATS},
}


def _wrong(rng: Random) -> None:
    raise KeyError(int(rng.integers(9)))


def _forever(rng: Random) -> None:
    end = time.process_time() + 1.0
    while time.process_time() < end:
        rng.random()


# What must be found, to see that it would be.
PLANTED: dict[str, Callable[[Path], Run]] = {
    "wrong": lambda _: guarded(_wrong),
    "forever": lambda _: guarded(_forever),
    "memory": lambda _: guarded(lambda rng: np.full(150_000_000, rng.random())[:0].sort()),
    "death": lambda _: guarded(lambda _: os._exit(3)),
}
