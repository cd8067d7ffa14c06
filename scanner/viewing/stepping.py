"""Steps of a result from its page: the box that is drawn, kept as a step of every export, and taking the last back."""

import numpy as np

from calib.numerics import Floats
from scanner.cleaning import read_cleaned
from scanner.configuration import CloudStep
from scanner.errors import InputError
from scanner.results import read_steps, write_steps
from scanner.viewing.crop import Box
from scanner.viewing.result import ViewedCloud, ViewedResult


def keep_box(result: ViewedResult, name: str, cloud: ViewedCloud, box: Box) -> None:
    """Write a box around a part of the cloud called `name` as the result's last step. Raises InputError, StorageError
    if it has no wall, or cannot be written.
    """
    if not box.bounded:
        raise InputError("the box holds everything: move an end of a range first")
    cleaned = read_cleaned(result.folder, result.number_of(name))
    frame = box.frame
    along = frame.along(cloud.points)
    reach = np.ptp(along, axis=0)
    low = np.where(np.isfinite(box.low), box.low, along.min(axis=0) - reach)
    high = np.where(np.isfinite(box.high), box.high, along.max(axis=0) + reach)
    # The steps' axes may be others than the cloud's.
    corners = cleaned.clouds()[-1].frame @ (frame.origin + np.stack([0 * frame.origin, frame.axes[0], frame.axes[1]]))
    steps = [*cleaned.steps, CloudStep(box=_text(np.concatenate([low, high, corners.ravel()])))]
    read_cleaned(result.folder, steps=steps).clouds()
    write_steps(result.folder, steps)


def take_back(result: ViewedResult) -> None:
    """Take the result's last step back. Raises InputError, StorageError."""
    write_steps(result.folder, read_steps(result.folder)[:-1])


def _text(lengths: Floats) -> str:
    return ",".join("0" if abs(length) < 1e-6 else f"{length:.9g}" for length in lengths)
