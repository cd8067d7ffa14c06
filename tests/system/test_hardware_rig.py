"""For owners of a rig: `ROOMSCAN_RIG=my-rig.yaml pytest -m hardware` tests the devices of a configuration.

Any scene is suitable if the camera sees the projector's light. The loopback rig passes as well.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hw.aravis import backend as aravis
from hw.open_rig import open_rig
from hw.projector import list_screens
from hw.timing import SynchronisedRig
from scanner.capture import capture
from scanner.configuration import Config, load_config
from scanner.patterns import Axis, Black, Gray, Pattern, White

pytestmark = pytest.mark.hardware

VARIABLE = "ROOMSCAN_RIG"


@pytest.fixture(scope="module")
def config() -> Config:
    if VARIABLE not in os.environ:
        pytest.skip(f"{VARIABLE} names no configuration of a rig")
    return load_config(Path(os.environ[VARIABLE]))


@pytest.fixture(scope="module")
def rig(config: Config) -> Iterator[SynchronisedRig]:
    with open_rig(config.required_rig, config.camera_size, config.projector_size) as opened:
        assert isinstance(opened.rig, SynchronisedRig)
        yield opened.rig


def test_the_devices_are_listed(config: Config) -> None:
    assert aravis.load().list_cameras()
    assert config.projector_size in [(screen.width, screen.height) for screen in list_screens()]


def test_the_latency_is_that_of_a_projector(rig: SynchronisedRig) -> None:
    assert 0 <= rig.timing.latency_s < 0.5
    assert rig.timing.latency_s < rig.timing.delay_s < rig.timing.latency_s + 0.05


def test_white_is_well_exposed(rig: SynchronisedRig) -> None:
    white, black = (frame.image for _, frame in capture(rig, (White(), Black())).frames)
    highest = rig.camera.highest_level
    lit = white.astype(float) - black > 0.1 * highest
    assert lit.mean() > 0.05, "the projector lights too little of the image: open the aperture, or expose longer"
    assert np.mean(white[lit] >= highest) < 0.05, "white is overexposed: close the aperture, or expose less"


def test_each_frame_shows_its_own_pattern(rig: SynchronisedRig) -> None:
    """Lit pixels follow every bit: they are brighter in the pattern that is bright there."""
    width, height = rig.projector.size
    patterns: list[Pattern] = [White(), Black()]
    axes: tuple[tuple[Axis, int], ...] = (("x", width), ("y", height))
    for axis, length in axes:
        bits = int(np.ceil(np.log2(length)))
        patterns += [Gray(axis, bit, bits, inverted=inverted) for bit in range(3) for inverted in (False, True)]
    frames = [grey(frame.image) for _, frame in capture(rig, tuple(patterns)).frames]
    white, black = frames[:2]
    lit = white - black > 0.5 * np.percentile(white - black, 99)
    for pattern, image, inverse in zip(patterns[2::2], frames[2::2], frames[3::2], strict=True):
        decided = np.abs(image - inverse)[lit] > 0.5 * (white - black)[lit]
        assert decided.mean() > 0.8, f"{pattern} and its inverse look alike"
        assert np.median(np.abs(image + inverse - white - black)[lit] / (white - black)[lit]) < 0.1


def test_a_scan_costs_little_more_than_its_light(rig: SynchronisedRig) -> None:
    list(capture(rig, (White(), Black()) * 10).frames)
    assert rig.sequential.tally.retriggered <= 2
    assert rig.overhead < 1.0


def grey(image: np.ndarray) -> np.ndarray:
    return image.astype(float) if image.ndim == 2 else image.mean(axis=2)
