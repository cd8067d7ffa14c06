"""Sequences that stop early, anywhere: the rest is decoded, and the missing part is reported."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Calibration, Intrinsics, Pose
from scanner.decoding.decoder import Decoder
from scanner.decoding.planning import plan_sequence, usable
from scanner.errors import InputError
from scanner.patterns import PRESETS, Gray, Pattern, Phase, PresetName, draw, sequence_for

SIZE = (214, 120)
STANDARD = PRESETS["standard"].patterns(SIZE)
FRINGES = next(n for n, pattern in enumerate(STANDARD) if isinstance(pattern, Phase))


def sees_itself(patterns: tuple[Pattern | None, ...], shown: tuple[Pattern, ...]) -> np.ndarray:
    """Return the error of each match (N, 2) for a camera that sees exactly the projector's picture."""
    kept = tuple(pattern for pattern in patterns if pattern is not None)
    decoder = Decoder(kept, SIZE)
    noise = np.random.default_rng(0)
    for decoded_as, pattern in zip(patterns, shown, strict=False):
        if decoded_as is not None:
            level = 20 + 0.6 * draw(pattern, SIZE) + noise.normal(0, 0.7, SIZE[::-1])
            decoder.add(np.rint(level).astype(np.uint8))
    matches = decoder.finish().matches
    return matches.projector_px - matches.camera_px


@given(name=st.sampled_from(sorted(PRESETS)), share=st.floats(0, 1), exposures=st.integers(1, 3))
def test_every_prefix_decodes_or_is_refused(name: PresetName, share: float, exposures: int) -> None:
    planned = tuple(pattern for pattern in PRESETS[name].patterns(SIZE) for _ in range(exposures))
    taken = planned[: round(share * len(planned))]
    found, said = None, ""
    try:
        found = usable(taken, planned, SIZE)
    except InputError as error:
        said = str(error)
    if found is None:
        assert "Missing or left out: bits" in said
        assert not any(pattern.axis == "y" and pattern.bit > 1 for pattern in taken if isinstance(pattern, Gray))
        return
    assert len(found.patterns) == len(taken)
    kept = [pattern for pattern in found.patterns if pattern is not None]
    plan = plan_sequence(kept[::exposures], SIZE)
    assert len(kept) == exposures * len(plan.shown)
    assert (found.finding is None) == (len(taken) == len(planned))
    finest = max(plan.x.cell, plan.y.cell)
    assert finest == 8 or f"cells of {finest:g} projector px" in str(found.finding)


def test_more_frames_give_more_or_better_matches() -> None:
    """From one match per cell, by pixels interpolated between stripe edges, to fringes at each pixel."""
    found = []
    for count in (FRINGES - 4, FRINGES, FRINGES + 4, FRINGES + 8, len(STANDARD)):
        off = sees_itself(usable(STANDARD[:count], STANDARD, SIZE).patterns, STANDARD)
        found.append((len(off), float(np.abs(off).max())))
    (cut_short, _), coded, begun, (one_fringe, error), (whole, least) = found
    assert 27 * 2 <= cut_short <= 27 * 4  # cells of 32 px along y
    assert begun == coded
    assert 0.7 < coded[0] / (SIZE[0] * SIZE[1]) <= 1  # not those before the first edge and behind the last
    assert 0.001 < coded[1] < 0.05
    assert 0.9 < one_fringe / (SIZE[0] * SIZE[1]) <= 1
    assert 0.9 < whole / one_fringe < 1.1
    assert 0.01 < least < 1.1 * error < 0.5


def test_an_incomplete_fringe_is_reported() -> None:
    words = str(usable(STANDARD[: FRINGES + 10], STANDARD, SIZE).finding)
    assert f"{FRINGES + 10} of its {len(STANDARD)} frames were taken" in words
    assert "the fringes along x of 6.7 px, the fringes along y of 6.7 px" in words
    assert "x comes from fringes of 16 px; y comes from fringes of 16 px" in words


def test_a_calibration_replaces_the_missing_coordinate() -> None:
    found = usable(STANDARD[: FRINGES - 4], STANDARD, SIZE, calibrated=True)
    assert "y follows from the calibration" in str(found.finding)
    assert {pattern.axis for pattern in found.patterns if isinstance(pattern, Gray)} == {"x"}
    # The fringe along y is complete, that along x is not.
    found = usable(STANDARD[: FRINGES + 7], STANDARD, SIZE, calibrated=True)
    assert {pattern.axis for pattern in found.patterns if isinstance(pattern, Phase)} == {"y"}
    assert "x follows from the calibration" in str(found.finding)
    device = Intrinsics(*SIZE, (200.0, 200.0), (107.0, 60.0))
    known = Calibration(device, device, Pose(np.eye(3), np.array([0.3, 1.0, 0.0])))
    Decoder([pattern for pattern in found.patterns if pattern is not None], SIZE, known)


def test_the_finest_bits_of_another_programs_capture_may_be_missing() -> None:
    whole = sequence_for(SIZE, cell=1, shifts=0)
    without = tuple(pattern for pattern in whole if not (isinstance(pattern, Gray) and pattern.bit >= 6))
    found = usable(without, (), SIZE)
    assert "bits 6, 7 of the Gray code along x" not in str(found.finding)  # nobody has said that there were any
    assert "x is known to some 0.05 projector px between the edges of stripes" in str(found.finding)
    assert "elsewhere to cells of 4 projector px (± 1.2 px); y is known" in str(found.finding)
    off = sees_itself(found.patterns, without)
    assert 0.9 < len(off) / (SIZE[0] * SIZE[1]) <= 1
    assert 0.001 < np.abs(off).max() < 0.1


@pytest.mark.parametrize(("preset", "fringes"), [("standard", 16), ("quick", 0)])
def test_a_missing_bit_keeps_the_coarser_ones(preset: PresetName, fringes: int) -> None:
    """Two periods determine the fringe order within longer cells, too; one period does not."""
    whole = PRESETS[preset].patterns(SIZE)
    left = tuple(p for p in whole if not (isinstance(p, Gray) and (p.axis, p.bit) == ("x", 2)))
    found = usable(left, (), SIZE)
    assert {p.bits for p in found.patterns if isinstance(p, Gray) and p.axis == "x"} == {2}
    assert sum(isinstance(pattern, Phase) for pattern in found.patterns) == fringes
    assert ("to cells of 64 projector px" in str(found.finding)) == (fringes == 0)


def test_undecodable_sequences_are_refused_as_usual() -> None:
    with pytest.raises(InputError, match=r"the Gray code along x \(cell 8, offset 0\) has 5 bits, but no frame shows"):
        usable(STANDARD[:4], (), SIZE)
