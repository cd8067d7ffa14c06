"""What is not used of a file, or is no good in it, is told."""

from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Floats
from scanner.comparing.surfaces import read_compared
from scanner.io import write_scalar_ply
from tests.support.blob import Blob

POINTS = Blob().cloud(1000, 0)[0]
FAR = np.array([500_000.0, 4_000_000.0, 100.0])


def with_first(value: Floats | float, count: int = 30) -> Floats:
    points = POINTS.copy()
    points[:count] = value
    return points


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (POINTS, ""),
        (POINTS + FAR, ""),
        (
            (POINTS + FAR).astype(np.float32).astype(np.float64),
            "in single precision, so far from the origin in steps of",
        ),
        (with_first(np.nan), "30 of its points left out: coordinates that are no numbers."),
        (with_first(0.0), "30 of its points left out: exactly at (0, 0, 0)"),
        (with_first(1e9, 1), "1 of its points left out: too far away from all others."),
        (with_first(POINTS[30:60]), "30 of its points left out: others are at exactly the same place."),
    ],
)
def test_notes_say_what_is_wrong_with_a_cloud(points: Floats, told: str, tmp_path: Path) -> None:
    zeros = np.zeros_like(points)
    write_scalar_ply(tmp_path / "a.ply", points, zeros, zeros.astype(np.uint8), {}, "m", "")
    notes = read_compared(tmp_path / "a.ply").notes
    assert len(notes) == (1 if told else 0)
    assert told in " ".join(notes)
