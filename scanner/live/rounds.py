"""The rig's frames, round after round of one sequence, with pictures in flight where the rig can."""

import logging
import time
from collections.abc import Generator
from contextlib import closing
from typing import cast

import cv2
import numpy as np

from calib.geometry import Calibration
from calib.numerics import Image
from hw.errors import DeviceError, FrameLostError
from hw.rig import Frame, Redundancy, Rig
from scanner.capture import refuse_another_size
from scanner.live.cloud import Round
from scanner.live.first_look import FirstLook
from scanner.live.sequence import FRAMES, LiveSequence, shortened, widest_sequence
from scanner.patterns import Pattern, ProjectorResponse, draw, level_groups

log = logging.getLogger(__name__)

# This many in a row are one capture for the rig: frames are verified, and the latency is waited for once.
_IN_A_ROW = 20
_MOST_LOST = 10  # consecutive lost rounds that indicate a camera failure


def take_rounds(rig: Rig, sequence: LiveSequence, response: ProjectorResponse | None) -> Generator[Round | None]:
    """Rounds without end; None for a round with a lost frame. Raises DeviceError."""
    pictures = [_picture(pattern, rig.projector.size, response) for pattern in sequence.patterns]
    level = level_groups(sequence.patterns)
    number, lost_in_a_row = 0, 0
    while True:
        row = (pictures[n % FRAMES] for n in range(_IN_A_ROW * FRAMES))
        groups = [tuple(n + first for n in group) for first in range(0, _IN_A_ROW * FRAMES, FRAMES) for group in level]
        frames = rig.photograph(row, redundancy=Redundancy(level=groups))
        taken: list[Frame] = []
        try:
            for frame in frames:
                refuse_another_size(frame, rig.camera.size)
                taken.append(frame)
                if len(taken) == FRAMES:
                    yield Round(number, tuple(taken), _grey(taken), time.monotonic())
                    number, taken, lost_in_a_row = number + 1, [], 0
        except FrameLostError as lost:
            log.info("round %d was lost (%s)", number, str(lost))
            number, lost_in_a_row = number + 1, lost_in_a_row + 1
            if lost_in_a_row == _MOST_LOST:
                raise DeviceError(f"{_MOST_LOST} rounds one after the other lost a frame; the last: {lost}") from lost
            yield None
        finally:
            if isinstance(frames, Generator):
                frames.close()


def best_sequence(
    rig: Rig, first_look: FirstLook, calibration: Calibration, depths: tuple[float, float] | None
) -> LiveSequence:
    """The shortest fringes that are unambiguous, from one round of longer ones. Raises DeviceError, RefusalError."""
    widest = widest_sequence(calibration, depths)
    with closing(take_rounds(rig, widest, first_look.response)) as taken:
        return shortened(
            widest, next(taken_round for taken_round in taken if taken_round is not None).grey, first_look, calibration
        )


def _picture(pattern: Pattern, size: tuple[int, int], response: ProjectorResponse | None) -> Image:
    return draw(pattern, size) if response is None else response.compensation[draw(pattern, size)]


def _grey(frames: list[Frame]) -> Image:
    """(N, H, W) of grey (H, W) or BGR (H, W, 3) images."""
    images = [frame.image for frame in frames]
    grey = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image for image in images]
    return cast(Image, np.stack(grey))
