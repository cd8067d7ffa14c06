"""A player and a projector: which picture is shown from when on, from the video file."""

from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np

from calib.numerics import Image

_SAME = 1.0  # mean difference of grey levels below which a frame repeats the previous picture


@dataclass(frozen=True)
class Played:
    """`pictures`: 8-bit images as sent to the projector; `shown`: their indices and start times, in order."""

    pictures: list[Image]
    shown: list[tuple[float, int]]
    length_s: float


def play(video: Path) -> Played:
    """Decode a whole video; repeated pictures are kept once."""
    pictures: list[Image] = []
    shown: list[tuple[float, int]] = []
    rate = 30.0
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        rate = float(stream.average_rate or rate)
        number = 0
        for number, frame in enumerate(container.decode(stream)):
            grey = cv2.cvtColor(frame.to_ndarray(format="rgb24"), cv2.COLOR_RGB2GRAY)
            if shown and _alike(grey, pictures[shown[-1][1]]):
                continue
            known = next((index for index, picture in enumerate(pictures) if _alike(grey, picture)), len(pictures))
            pictures[known:] = pictures[known:] or [grey]
            shown.append((number / rate, known))
    return Played(pictures, shown, (number + 1) / rate)


def _alike(one: Image, other: Image) -> bool:
    return float(np.mean(cv2.absdiff(one, other))) < _SAME
