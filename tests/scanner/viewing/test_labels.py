"""Labels are beside what they name."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scanner.viewing.scene import _end_of_common_edge


@pytest.mark.parametrize("seed", range(5))
def test_an_angles_label_is_two_thirds_along_the_common_edge_of_its_faces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertex, legs = rng.normal(size=3), Rotation.random(random_state=seed).as_matrix() * rng.uniform(1, 3, (3, 1))
    first = vertex + np.array([np.zeros(3), legs[0], legs[0] + legs[1], legs[1]])
    second = vertex + np.array([np.zeros(3), legs[0], legs[0] + legs[2], legs[2]])
    np.testing.assert_allclose(_end_of_common_edge(first, second), vertex + 2 / 3 * legs[0], atol=1e-12)
