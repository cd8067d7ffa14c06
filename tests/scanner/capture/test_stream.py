"""Smooth errors of a film are those measured at import, plus those of any frames."""

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.rig import Capabilities, Frame, Rig
from scanner.capture import with_smooth_errors_of_film
from scanner.capture.stream import capture
from scanner.patterns import draw
from tests.support.small_capture import PATTERNS, SIZE


class Mirror:
    """A projector and a camera in one that sees what it shows, and records its calls."""

    def __init__(self, delivered: tuple[int, int] = SIZE) -> None:
        self.size = SIZE
        self.highest_level = 255
        self.capabilities = Capabilities()
        self.asked: list[str] = []
        self._delivered = delivered
        self._shown = np.zeros(SIZE[::-1], np.uint8)

    def show(self, image: np.ndarray) -> None:
        self.asked.append("show")
        self._shown = image

    def grab(self) -> Frame:
        self.asked.append("grab")
        return Frame(np.resize(self._shown, self._delivered[::-1]))


def test_each_frame_shows_its_pattern_and_is_taken_on_request() -> None:
    mirror = Mirror()
    stream = capture(Rig(mirror, mirror, {"camera": "a mirror"}), PATTERNS)
    assert mirror.asked == []
    for count, (pattern, frame) in enumerate(stream.frames, start=1):
        np.testing.assert_array_equal(frame.image, draw(pattern, SIZE))
        assert mirror.asked == ["show", "grab"] * count
    assert count == len(PATTERNS)
    assert stream.patterns == PATTERNS
    assert stream.metadata == {"devices": {"camera": "a mirror"}}


def test_a_camera_that_contradicts_itself_has_failed() -> None:
    mirror = Mirror(delivered=(24, 16))
    with pytest.raises(DeviceError, match=r"48 × 32.*24 × 16"):
        list(capture(Rig(mirror, mirror), PATTERNS).frames)


@pytest.mark.parametrize(
    ("metadata", "expected_px"),
    [
        ({}, 0.0003),
        ({"recording": {"smooth_px": 0.0004}}, 0.0005),
        ({"recording": {"smooth_px": 0.0}}, 0.0003),
        ({"recording": {}}, 0.0012),
        ({"recording": {"smooth_px": "small"}}, 0.0012),
        ({"recording": {"smooth_px": float("nan")}}, 0.0012),
        ({"recording": {"smooth_px": -1}}, 0.0012),
    ],
)
def test_smooth_errors_of_a_film_are_added(metadata: dict[str, object], expected_px: float) -> None:
    assert with_smooth_errors_of_film(0.0003, metadata) == pytest.approx(expected_px)
