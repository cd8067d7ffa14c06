"""Does each pixel of a picture become one of the projector? Lines of one pixel tell, in five pictures before a capture.

Lines of black and white send as much light as wide stripes do, if they arrive as they are. Scaled, or corrected for
keystone, they become greyer, and of grey a projector makes less than half of white, for its response bends. The camera
only has to see how bright they are. A picture that was scaled alone is as good as any other; one that was corrected for
keystone is of oblong, skewed pixels, which three faces in one view hardly contradict.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import SQUARE_PIXELS, PixelGrid
from calib.numerics import Floats, Image, grey
from hw.rig import Rig
from scanner.capture.stream import refuse_another_size
from scanner.patterns import Axis

LINES_KEY = "lines_of_one_pixel_keep"

CHANGED_SHAPE = FindingKind(
    "changed-shape",
    "The projector does not show single pixels unchanged: it scales its picture, changes its shape, or lets pixels "
    "share their light. Keystone correction would make the focal lengths wrong.",
    "Show the picture in the projector's own resolution, turn keystone correction, digital zoom and aspect correction "
    "off, and move the projector instead.",
    ("kept_contrast_share",),
)
_STRIPE_PX = 8
_BLACK, _MIDDLE, _WHITE = 0, 128, 255
# What is lit has so much of what the brightest few do.
_LIT, _BRIGHT_PERCENTILE = 0.1, 99.0
# Where grey is nearly half of white, lines tell nothing.
_LEAST_BEND = 0.05
# Of what lines and grey differ by: scaled by most factors, or corrected for 1 % of keystone, they keep 0.3 to 0.4; of
# pixels that share a tenth of their light, 0.7. Nine tenths and more are kept only where the picture's corners move by
# less than the half pixel from which on a keystone matters.
_LEAST_KEPT, _UNCHANGED = 0.6, 0.9


def measure_lines(rig: Rig, grid: PixelGrid = SQUARE_PIXELS) -> list[Mapping[str, object]]:
    """For the recording of each camera: what lines of one pixel keep of what they and grey differ by, from 0 to 1;
    nothing where the camera cannot tell. The pixels are those of `grid`.

    Raises DeviceError if a device fails or a camera delivers frames of another size.
    """
    size = grid.device_size(rig.projector.size)
    # A ghost of the picture before is of as much light, or of less by little.
    pictures = [
        _even(size, _BLACK),
        _even(size, _MIDDLE),
        lines_of_light("x", size, (_BLACK, _WHITE), _STRIPE_PX),
        lines_of_light("x", size, (_BLACK, _WHITE)),
        lines_of_light("y", size, (_BLACK, _WHITE)),
    ]
    levels: list[list[Floats]] = [[] for _ in rig.all]
    for frames in rig.photograph_together([grid.spread(picture) for picture in pictures]):
        for camera_rig, frame, of_camera in zip(rig.all, frames, levels, strict=True):
            refuse_another_size(frame, camera_rig.camera.size)
            # Of all pixels: a camera may resolve the lines, and some would beat.
            of_camera.append(grey(frame.image).astype(np.float32))
    return [_kept(of_camera) for of_camera in levels]


def _kept(levels: Sequence[Floats]) -> Mapping[str, object]:
    """By the brightness of each picture, (H, W)."""
    black, middle, wide, *thin = levels
    light = middle - black
    lit = light > max(_LIT * float(np.percentile(light, _BRIGHT_PERCENTILE)), 1.0)
    if not lit.any():
        return {}
    of_black, of_grey, of_wide, *of_thin = (
        float(picture[lit].mean(dtype=np.float64)) for picture in (black, middle, wide, *thin)
    )
    bend = of_wide - of_grey
    if bend < _LEAST_BEND * (of_wide - of_black):
        return {}
    return {LINES_KEY: round(min((level - of_grey) / bend for level in of_thin), 2)}


def lines_of_light(axis: Axis, size: tuple[int, int], levels: tuple[int, int], px: int = 1) -> Image:
    """Two grey levels by turns along an axis, each so many pixels wide, in a picture of this size, (width, height)."""
    width, height = size
    number = np.arange(width)[None, :] if axis == "x" else np.arange(height)[:, None]
    values = np.array(levels, np.uint8)[number // px % 2]
    return np.ascontiguousarray(np.broadcast_to(values, (height, width)))


def known_of_lines(metadata: Mapping[str, object]) -> Mapping[str, object]:
    """The same, of a recording that was begun."""
    return {key: value for key, value in metadata.items() if key == LINES_KEY}


def shows_single_pixels(metadata: Mapping[str, object]) -> bool:
    """Whether a recording says that the projector shows its picture pixel for pixel."""
    kept = metadata.get(LINES_KEY)
    return isinstance(kept, int | float) and kept >= _UNCHANGED


def findings_on_lines(metadata: Mapping[str, object]) -> Iterator[Finding]:
    """Yield a warning about the recorded contrast of one-pixel lines."""
    kept = metadata.get(LINES_KEY)
    if isinstance(kept, int | float) and kept < _LEAST_KEPT:
        yield Finding(
            CHANGED_SHAPE,
            Severity.WARNING,
            f"The projector does not show single pixels unchanged: lines of one pixel keep {max(kept, 0):.0%} of their "
            "contrast. It scales the picture, changes its shape, or lets pixels share their light. If it corrects for "
            "keystone, which the finest stripes do not show, the focal lengths are wrong, by 4 to 20 % for 1 % of it.",
            "Show the picture in the projector's own resolution, turn such corrections off, and move the projector "
            "instead.",
            {"kept_contrast_share": float(kept)},
        )


def _even(size: tuple[int, int], level: int) -> Image:
    width, height = size
    return np.full((height, width), level, np.uint8)
