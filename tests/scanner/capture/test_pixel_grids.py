"""Projectors of oblong pixels in shifted rows show patterns, and are decoded, in square pixels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import PixelGrid
from calib.numerics import Floats
from hw.open_rig import open_rig
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.capture import capture, measure_lines, open_capture
from scanner.configuration import Config
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.patterns import PRESETS, Gray, Phase, aspect_to_dict
from tests.support.command_line import run
from tests.support.small_capture import SIZE

DIAMOND = PixelGrid(aspect=0.5, odd_rows=0.5)
CAMERA, SQUARE = (640, 540), (456, 285)  # of 228 × 285 mirrors, whose rows the camera resolves
ROOM = SimulatedRigSettings(furniture=False, interreflection=False, pixel_aspect=0.5, odd_rows=0.5)


@pytest.fixture(scope="module")
def truth_px() -> Floats:
    """The square pixel (H, W, 2) of each camera pixel."""
    return SimulatedRoom(ROOM, CAMERA, SQUARE).ground_truth().projector_px


def errors_px(grid: PixelGrid, truth_px: Floats) -> tuple[Floats, Floats]:
    """Errors (n,) along x less their median, and the decoded rows (n,), of a diamond array that is taken for a grid."""
    with open_rig(ROOM, CAMERA, SQUARE, grid) as opened:
        stream = capture(opened.rig, PRESETS["standard"].patterns(SQUARE))
        decoder = Decoder(stream.patterns, stream.projector_size)
        for _, frame in stream.frames:
            decoder.add(frame.image)
    matches = decoder.finish().matches
    assert len(matches) > 0.5 * np.count_nonzero(np.isfinite(truth_px[..., 0]))
    x, y = np.rint(matches.camera_px).astype(int).T
    error_px = matches.projector_px - truth_px[y, x]
    good = (np.abs(error_px) < 2).all(axis=1)
    return error_px[good, 0] - np.median(error_px[good, 0]), matches.projector_px[good, 1]


def alternating_px(error_px: Floats, row: Floats) -> float:
    """Half of what even and odd rows differ by."""
    parity = np.cos(np.pi * row)
    return float(error_px @ parity / (parity @ parity))


def test_pictures_are_drawn_where_the_mirrors_are(truth_px: Floats) -> None:
    in_columns, in_place = errors_px(PixelGrid(0.5), truth_px), errors_px(DIAMOND, truth_px)
    assert 0.02 < alternating_px(*in_columns) < 0.15
    assert abs(alternating_px(*in_place)) < 0.003
    assert 0.01 < np.median(np.abs(in_place[0])) < 0.5 * np.median(np.abs(in_columns[0]))


def test_single_mirrors_are_shown_unchanged() -> None:
    with open_rig(ROOM, CAMERA, SQUARE, DIAMOND) as opened:
        (lines,) = measure_lines(opened.rig, DIAMOND)
    with open_rig(ROOM, CAMERA, SQUARE, PixelGrid(0.5)) as opened:
        (in_square_pixels,) = measure_lines(opened.rig)
    assert all(0.9 < float(str(kept)) <= 1.05 for kept in lines.values())
    assert lines.keys() == in_square_pixels.keys() != set()
    assert all(float(str(kept)) < 0.3 for kept in in_square_pixels.values())


def test_a_configured_size_is_that_of_the_mirrors() -> None:
    config = Config.model_validate({"projector": {"width": 912, "height": 1140, "pixel_aspect": 0.5}})
    assert config.projector_size == (1824, 1140)
    assert config.projector.grid.device_size(config.projector_size) == (912, 1140)


def test_a_listing_in_mirrors_is_told_in_square_pixels_once(capture_folder: Path) -> None:
    recording = open_capture(capture_folder)
    assert recording.in_square_pixels(PixelGrid()) is recording
    told = recording.in_square_pixels(DIAMOND)
    assert told.projector_size == (2 * SIZE[0], SIZE[1])
    for before, after in zip(recording.patterns, told.patterns, strict=True):
        if isinstance(before, Gray) and isinstance(after, Gray):
            assert after.cell == (2 if after.axis == "x" else 1) * before.cell
        if isinstance(before, Phase) and isinstance(after, Phase):
            assert after.period == (2 if after.axis == "x" else 1) * before.period
    again = replace(recording, metadata={**recording.metadata, **aspect_to_dict(DIAMOND)})
    assert again.in_square_pixels(DIAMOND) is again
    assert again.in_square_pixels(PixelGrid()) is again
    with pytest.raises(InputError, match=r"have a pixel_aspect of 0\.5, but projector.pixel_aspect is 2"):
        again.in_square_pixels(PixelGrid(2.0))


def test_a_scan_says_of_what_shape_its_pixels_are(tmp_path: Path) -> None:
    config = tmp_path / "diamond.yaml"
    config.write_text(
        "rig: {backend: simulated, furniture: false, interreflection: false, pixel_aspect: 0.5, odd_rows: 0.5}\n"
        "camera: {width: 320, height: 270}\n"
        "projector: {width: 214, height: 268, pixel_aspect: 0.5, odd_rows: 0.5}\n"
    )
    assert run("--config", config, "--out", tmp_path / "scan", "--quiet") == 0
    recording = open_capture(tmp_path / "scan" / "capture")
    assert (recording.projector_size, recording.metadata["pixel_aspect"]) == ((428, 268), 0.5)
    assert run("patterns", "--config", config, "--out", tmp_path / "patterns", "--quiet") == 0
    listing = (tmp_path / "patterns" / "sequence.yaml").read_text(encoding="utf-8")
    assert "projector: {width: 428, height: 268}\npixel_aspect: 0.5\n" in listing
