"""Anomalies of codes beside frames in which something moved."""

import numpy as np
import pytest

from scanner.decoding.light.frame_checks import anomaly
from scanner.decoding.motion import InconsistentPixels
from scanner.decoding.planning import plan_sequence
from scanner.decoding.sample_analysis import _explained
from scanner.errors import InputError
from scanner.patterns import PRESETS
from tests.support.synthetic_capture import Scene

SCENE = Scene()


@pytest.mark.parametrize(("first_moved", "is_explained"), [(2, False), (3, False), (5, True), (9, True), (11, False)])
def test_bits_beside_frames_with_motion_are_not_taken_for_exchanged(first_moved: int, is_explained: bool) -> None:
    plan = plan_sequence(PRESETS["quick"].patterns(SCENE.projector), SCENE.projector)
    nowhere = np.zeros((1, 1), np.bool_)
    inconsistent = InconsistentPixels(nowhere, nowhere, ~nowhere, 0.05, (first_moved, first_moved + 1))
    contradicting = anomaly("cells are not neighbours", (7, 8))
    if is_explained:
        assert [*_explained(plan, [contradicting], [], inconsistent)] == [contradicting]
    else:
        with pytest.raises(InputError, match="not neighbours"):
            _explained(plan, [contradicting], [], inconsistent)
