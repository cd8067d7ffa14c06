"""Well-formed matches of no corner are refused with a reason, whichever equation fails."""

from collections.abc import Callable

import numpy as np
import pytest

from calib.geometry import Matches
from calib.numerics import Floats
from calib.refinement import PrincipalPoint
from calib.refusal import RefusalError
from calib.self_calibration import Method, self_calibrate
from tests.support.cloud_scene import CAMERA, PROJECTOR, room

Change = Callable[[Floats, Floats, np.ndarray], None]


def _set(pixels: Floats, value: Floats | float) -> None:
    pixels[:] = value


def _on_face(pixels: Floats, face: np.ndarray, column: slice | int, value: float) -> None:
    pixels[face == 1, column] = value


CHANGES: dict[str, Change] = {
    "a face at one projector pixel": lambda _, p, face: _on_face(p, face, slice(None), 50.0),
    "a face at one camera pixel": lambda c, _, face: _on_face(c, face, slice(None), 50.0),
    "a face on a line": lambda _, p, face: _on_face(p, face, 1, 50.0),
    "a face on a line of the camera": lambda c, _, face: _on_face(c, face, 1, 50.0),
    "all at one pixel": lambda _, p, __: _set(p, 50.0),
    "all in one column": lambda c, _, __: _set(c[:, 0], 50.0),
    "the same pixels": lambda c, p, _: _set(p, c),
    "next to nothing": lambda c, _, __: _set(c, 1e-9 * c),
    "noise": lambda _, p, __: _set(p, np.random.default_rng(0).uniform(0, 400, p.shape)),
    "few steps": lambda _, p, __: _set(p, np.round(p / 256) * 256),
}


@pytest.mark.filterwarnings("ignore")  # NumPy's, of divisions on the way to the refusal
@pytest.mark.parametrize("method", ["refined", "paper"])
@pytest.mark.parametrize("change", CHANGES)
def test_matches_of_no_corner_are_refused(change: str, method: Method) -> None:
    whole = room().matches
    some = whole[np.sort(np.random.default_rng(0).permutation(len(whole))[:600])]
    camera_px, projector_px = some.camera_px.copy(), some.projector_px.copy()
    CHANGES[change](camera_px, projector_px, some.labels)
    with pytest.raises(RefusalError) as caught:
        self_calibrate(
            Matches(camera_px, projector_px, some.face),
            CAMERA.size,
            PROJECTOR.size,
            principal_point=PrincipalPoint((209.0, 176.0), 20.0),
            method=method,
        )
    assert caught.value.reason
    assert caught.value.advice
