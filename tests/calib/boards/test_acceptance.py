"""What is refused of boards says by how much."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.boards.acceptance import BoardCoverage, refuse_untrustworthy
from calib.boards.estimate import Estimate
from calib.boards.parameters import CAMERA, PROJECTOR, SHARED
from calib.geometry import Size
from calib.refusal import RefusalError

_SIZE = Size(640, 480)
_WIDE = BoardCoverage(40.0, 1.5, 0.6, 0.6)


@pytest.mark.parametrize(("device", "start"), [("camera", CAMERA.start), ("projector", PROJECTOR.start)])
def test_a_focal_length_that_boards_leave_open_is_named_with_its_sigma(device: str, start: int) -> None:
    variances = np.full(SHARED, 1e-6)
    variances[start] = 0.17**2
    found = cast(Estimate, SimpleNamespace(covariance=np.diag(variances)))
    with pytest.raises(
        RefusalError, match=f"hardly determine the {device}'s focal length: its sigma is 17 %"
    ) as caught:
        refuse_untrustworthy(found, [], _WIDE, (_SIZE, _SIZE))
    assert caught.value.finding.data["sigma_percent"] == pytest.approx(17.0, abs=0.01)


def test_what_is_wrong_with_how_boards_were_held_is_told_in_numbers() -> None:
    assert _WIDE.reasons == []
    assert BoardCoverage(4.0, 1.02, 0.07, 0.6).reasons == [
        "the boards are nearly parallel to each other, within 4 degrees",
        "they are all at about the same distance, within 2 %",
        "they cover only 7 % of the camera's picture",
    ]
