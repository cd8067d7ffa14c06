"""Every mix of patterns that determines both coordinates decodes; one that does not is refused."""

import numpy as np
import pytest
from synthetic_capture import Scene, darker

from scanner.decode import Decoder
from scanner.errors import InputError
from scanner.patterns import Black, Gray, Pattern, Phase, White, gray_sequence, phase_sequence, sequence_for

SCENE = Scene()
SIZE = SCENE.projector


def both(*parts: tuple[str, tuple[float, ...]], ends: tuple[Pattern, ...] = ()) -> tuple[Pattern, ...]:
    """The same parts along x and y: ('gray', (cell, inverses)) or ('phase', (period, shifts))."""
    patterns: list[Pattern] = []
    for axis, length in (("x", SIZE[0]), ("y", SIZE[1])):
        for kind, (a, b) in parts:
            patterns += (
                gray_sequence(axis, length, int(a), inverses=bool(b))
                if kind == "gray"
                else phase_sequence(axis, a, int(b))
            )
    return (*patterns, *ends)


ENDS = (White(), Black())
# The patterns, and the upper bound of the median error: of each match's worse coordinate, in projector pixels.
MIXES = {
    "standard": (sequence_for(SIZE), 0.08),
    "quick": (sequence_for(SIZE, inverses=False, shifts=4), 0.2),
    "Gray and inverses only": (both(("gray", (1, 1))), 0.5),
    "Gray without inverses, white and black last": (both(("gray", (1, 0)), ends=ENDS), 0.5),
    "Gray without inverses, fringes, no white": (both(("gray", (8, 0)), ("phase", (16, 8))), 0.1),
    "cell as long as the period": (both(("phase", (20, 8)), ("phase", (30, 8)), ("gray", (30, 1))), 0.15),
    "periods from longest to shortest": (both(("phase", (512, 8)), ("phase", (96, 8)), ("phase", (16, 8))), 0.1),
    "short periods that differ": (both(*(("phase", (period, 8)) for period in (17, 19, 21)), ends=ENDS), 0.1),
    "an offset": (
        (
            *(Gray("x", bit, 7, 8, 3, inverted) for bit in range(7) for inverted in (False, True)),
            *phase_sequence("x", 16.0, 8),
            *gray_sequence("y", SIZE[1], 8),
            *phase_sequence("y", 16.0, 8),
        ),
        0.1,
    ),
    "uneven shifts": (
        (
            *gray_sequence("x", SIZE[0], 8),
            *(Phase("x", 16.0, shift) for shift in (0.0, 0.1, 0.35, 0.5, 0.77, 0.9)),
            *gray_sequence("y", SIZE[1], 8),
            *phase_sequence("y", 16.0, 6),
        ),
        0.25,
    ),
}


@pytest.mark.parametrize("name", MIXES)
def test_a_mix_decodes(name: str) -> None:
    patterns, limit_px = MIXES[name]
    decoding = SCENE.decode(patterns)
    error = np.abs(SCENE.errors(decoding)).max(axis=1)
    assert (0.02 if name.startswith("Gray and") else 0.003) < np.median(error) < limit_px
    assert np.percentile(error, 99) < 2.0
    well_lit = SCENE.well_lit()
    x, y = np.rint(decoding.matches.camera_px).astype(int).T
    kept = np.zeros(well_lit.shape, bool)
    kept[y, x] = True
    # Where no fringe refines the code, all camera pixels with one code are one match.
    share = (kept & well_lit).sum() / well_lit.sum()
    assert 0.3 < share <= 1.0 if name.startswith("Gray") else 0.95 < share <= 1.0


@pytest.mark.parametrize(("bits", "colour"), [(8, True), (10, False), (12, True), (16, False)])
def test_any_image_format(bits: int, colour: bool) -> None:
    scene = Scene(depth_bits=bits, colour=colour)
    error = np.abs(scene.errors(scene.decode(sequence_for(SIZE)))).max(axis=1)
    assert 0.003 < np.median(error) < 0.08


def test_less_light_is_less_certain() -> None:
    sigmas = []
    for factor in (1.0, 0.3):
        scene = darker(SCENE, factor)
        decoding = scene.decode(sequence_for(SIZE))
        error = np.abs(scene.errors(decoding)).max(axis=1)
        assert 0.003 < np.median(error) < 0.2
        assert decoding.matches.sigma_px is not None
        sigmas.append(np.median(decoding.matches.sigma_px))
    assert 1.2 < sigmas[1] / sigmas[0] < 10


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        ((White(), Black()), "x"),
        (tuple(gray_sequence("x", SIZE[0], 8)), "y"),
        (both(("gray", (8, 0)))[1:], "bit"),
        (both(("phase", (16, 8))), "16"),
        (both(("gray", (8, 1)), ("phase", (16, 2))), "shift"),
        ((*sequence_for(SIZE), White()), "same pattern"),
    ],
)
def test_a_mix_that_does_not_determine_both_coordinates_is_refused(patterns: tuple[Pattern, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Decoder(patterns, SIZE)


def test_frames_of_another_size_or_too_few_are_refused() -> None:
    patterns = sequence_for(SIZE)
    decoder = Decoder(patterns, SIZE)
    decoder.add(np.zeros((20, 30), np.uint8))
    with pytest.raises(InputError, match="30 × 20"):
        decoder.add(np.zeros((20, 31), np.uint8))
    with pytest.raises(InputError, match="frame"):
        decoder.finish()


def test_frames_that_show_nothing_are_refused() -> None:
    patterns = sequence_for(SIZE)
    decoder = Decoder(patterns, SIZE)
    for number in range(len(patterns)):
        decoder.add(np.random.default_rng(number).integers(10, 14, (60, 80)).astype(np.uint8))
    with pytest.raises(InputError):
        decoder.finish()
