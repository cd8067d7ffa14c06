"""Coarse coordinates of sampled pixels."""

import numpy as np
import pytest

from scanner.importing.coarse_coordinates import _runs_back


@pytest.mark.parametrize("spacing_px", [0.7, 2.0, 3.5, 5.0, 6.5, 9.0, 12.0, 15.0])
def test_a_fringe_runs_back_only_where_neighbours_tell(spacing_px: float) -> None:
    """Samples that are more than half a cell of 8 px apart do not tell which way a fringe of 16 px runs."""
    x = np.broadcast_to(spacing_px * np.arange(60), (40, 60))
    middle, certain = (np.floor(x / 8) + 0.5) * 8 - 0.5, np.ones(x.shape, np.bool_)
    assert not _runs_back(x / 16, middle, certain)
    assert _runs_back(-x / 16, middle, certain) == (spacing_px < 4)
