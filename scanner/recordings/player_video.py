"""Writing a sequence as a video that players show: H.264, 4:2:0, constant rate, nearly lossless."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanner.patterns import draw
from scanner.recordings.libav import av
from scanner.recordings.programme import BLACK, FRAMES_PER_SECOND, LEAD_IN_S, LEAD_OUT_S, WHITE, Programme

CONTAINERS = (".mp4", ".mov", ".mkv")
# At this quality, grey levels err by one or two; few players support lossless H.264.
_QUANTISER = "4"
_BLACK_LEVEL, _LEVELS = 16, 219  # luma range (ITU-R BT.709); players may not support others
_NO_COLOUR = 128
_LIMITED_RANGE, _BT_709 = 1, 1


def write_player_video(path: Path, programme: Programme) -> None:
    """A picture with an odd side gets another row or column. Raises InputError if PyAV is missing."""
    width, height = (side + side % 2 for side in programme.grid.device_size(programme.size))
    library = av()
    with library.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FRAMES_PER_SECOND)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"qp": _QUANTISER, "preset": "medium", "bf": "0", "g": str(FRAMES_PER_SECOND)}
        context = stream.codec_context
        context.color_range, context.colorspace = _LIMITED_RANGE, _BT_709
        context.color_primaries, context.color_trc = _BT_709, _BT_709
        number = 0
        for picture, frames in _pictures(programme):
            padded = np.pad(np.asarray(programme.grid.sample(picture), np.float64), [(0, 1)] * 2, mode="edge")[
                :height, :width
            ]
            luma = np.rint(_BLACK_LEVEL + padded * (_LEVELS / 255)).astype(np.uint8)
            planes = np.concatenate([luma, np.full((height // 2, width), _NO_COLOUR, np.uint8)])
            for _ in range(frames):
                frame = library.VideoFrame.from_ndarray(planes, format="yuv420p")
                frame.pts, frame.color_range = number, _LIMITED_RANGE
                number += 1
                container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _pictures(programme: Programme) -> Iterator[tuple[NDArray[np.uint8], int]]:
    """Yield each picture, and for how many frames it is shown."""
    width, height = programme.size
    fields = {WHITE: np.full((height, width), 255, np.uint8), BLACK: np.zeros((height, width), np.uint8)}
    hold = round(programme.hold_s * FRAMES_PER_SECOND)
    yield fields[BLACK], round(LEAD_IN_S * FRAMES_PER_SECOND)
    for slot in programme.slots:
        yield fields[slot] if slot in fields else draw(programme.patterns[slot], programme.size), hold
    yield fields[BLACK], round(LEAD_OUT_S * FRAMES_PER_SECOND)
