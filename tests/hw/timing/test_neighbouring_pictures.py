"""Light slightly late or early: the share of a neighbouring picture in a frame that matters."""

import numpy as np
import pytest

from hw.rig import Redundancy
from hw.timing.synchronisation import synchronised
from scanner.patterns import draw, level_groups, sequence_for
from tests.support.rig_bench import Bench

SIZE = (96, 64)
PATTERNS = sequence_for(SIZE, cell=8, inverses=True, periods=(16.0, 11.3), shifts=4)
LAST = len(PATTERNS) - 1
_FAINT = 8  # the finest fringe of both axes, as faint as behind a lens
_LIT = np.arange(SIZE[0]) % 5 != 4


def pictures() -> list[np.ndarray]:
    """The last fringes have two fifths of the others' contrast."""
    drawn = [draw(pattern, SIZE) for pattern in PATTERNS]
    return drawn[:-_FAINT] + [np.uint8(75) + picture // 5 * 2 for picture in drawn[-_FAINT:]]


def held(shown: list[np.ndarray], frame: np.ndarray, number: int) -> float:
    """The largest share of the previous or next picture in a frame, by ground truth."""
    own = shown[number].astype(float)
    off = ((frame - 10.0) / 12.0 - own)[:, _LIT]
    towards = [shown[other][:, _LIT] - own[:, _LIT] for other in (number - 1, number + 1) if 0 <= other <= LAST]
    return float(max(np.sum(off * toward) / np.sum(toward**2) for toward in towards))


@pytest.mark.parametrize(
    ("number", "late_ms"), [(3, 1.85), (LAST - 11, -5.2), (LAST - 5, -5.2), (LAST - 1, -5.2), (LAST, 1.85)]
)
def test_more_than_two_per_cent_of_a_neighbouring_picture_is_detected(
    monkeypatch: pytest.MonkeyPatch, number: int, late_ms: float
) -> None:
    """The previous picture stays too long, or the next comes too soon: in bits, in the steps of a fringe that is
    fainter than the previous one, and in the last frame. One per cent or less passes.
    """
    shown, most = pictures(), []
    for less_ms in (0.0, 0.6):
        bench = Bench(0.05, transfer_s=0.005, noise=12.0, size=SIZE).install(monkeypatch)
        rig = synchronised(bench, bench, {})
        bench.delay(number + (late_ms < 0), (late_ms - np.sign(late_ms) * less_ms) / 1e3)
        frames = list(rig.photograph(shown, redundancy=Redundancy(level_groups(PATTERNS))))
        most.append(max(held(shown, frame.image, index) for index, frame in enumerate(frames)))
        assert rig.pipelined is not None
        assert (rig.pipelined.doubted > 0) == (less_ms == 0)
    assert 0 < most[0] < 0.002 < most[1] < 0.01
