"""Equations that have no solution."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from calib.refusal import RefusalError, Wording


@contextmanager
def singular_refused(wording: Wording) -> Iterator[None]:
    """Equations without a solution, which follow from matches that are on no three planes, become a RefusalError."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise RefusalError(
            f"The matches determine no corner ({error}): those of a face lie on a line or in a few points, or "
            f"{wording.unrelated}.",
            wording.move,
        ) from error
