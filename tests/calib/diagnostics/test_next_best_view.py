"""What a person is told to do.

The note on a further capture says by how much it would help.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.diagnostics import NextView
from calib.diagnostics.findings import _on_next_view


@pytest.mark.parametrize(
    ("right_deg", "up_deg", "distance", "words"),
    [
        (25.0, 0.0, 1.0, "25° to the right"),
        (-25.0, 0.0, 1.0, "25° to the left"),
        (0.0, 15.0, 1.0, "15° upwards"),
        (0.0, -15.0, 0.7, "15° downwards and closer, to 0.7 × the distance"),
        (25.0, -15.0, 1.0, "25° to the right and 15° downwards"),
        (-25.0, 15.0, 1.3, "25° to the left, 15° upwards and farther away, to 1.3 × the distance"),
    ],
)
def test_moves_are_told_in_words(right_deg: float, up_deg: float, distance: float, words: str) -> None:
    assert NextView(right_deg, up_deg, distance, 0.01, np.zeros(3)).words == words


@pytest.mark.parametrize("view_sigma", [0.0071, 0.02])
def test_a_further_capture_is_noted_with_its_gain_where_it_is_worthwhile(view_sigma: float) -> None:
    refinement: Any = SimpleNamespace(covariance=np.diag(np.full(21, 0.02**2)))
    view = NextView(-25.0, 0.0, 1.3, view_sigma, np.zeros(3))
    findings = list(_on_next_view(refinement, view))
    if view_sigma == 0.02:
        assert findings == []
        return
    (finding,) = findings
    assert "25° to the left and farther away, to 1.3 × the distance" in finding.message
    assert "from 2 % to about 0.71 %" in finding.message
    assert finding.data == pytest.approx({"sigma_percent": 2.0, "expected_percent": 0.71})
