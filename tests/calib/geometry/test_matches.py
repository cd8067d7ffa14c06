"""Matches are counted."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Matches


@given(st.lists(st.integers(-1, 2), max_size=60))
def test_matches_on_each_face_are_counted(face: list[int]) -> None:
    nowhere = np.zeros((len(face), 2))
    counted = Matches(nowhere, nowhere, np.array(face, np.int32)).on_each_face
    assert counted.tolist() == [face.count(label) for label in range(3)]
    assert not Matches(nowhere, nowhere).on_each_face.any()
