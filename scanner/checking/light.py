"""Light measured on white and black pictures: where the projector's light arrives, ambient light, flicker,
and what is left of the picture before.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TypeVar

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Bools, Floats, Image, grey, robust_sigma
from hw.rig import Rig
from scanner.checking.report import LEAST_AMPLITUDE, TOLERATED_LOSS, CheckRow
from scanner.decoding import MUCH_FLICKER

# Least signal in standard deviations, as in the decoder.
_SEEN = 5.0
# Least brightness of directly lit pixels relative to the brightest; interreflection is darker, except close to a
# crease.
_DIRECT = 0.1
_BRIGHT_PERCENTILE = 99.0
# Share of the previous picture: a third of this costs 6 % of the intrinsics.
_MOST_GHOST = 0.01
# JPEG and demosaicing spread clipped pixels over their neighbours' levels.
CLIPPED = 254 / 255

CHECKED_AMBIENT_LIGHT = FindingKind(
    "check-ambient-light",
    "What scan check says of light that is not the projector's.",
    "Darken the room, or bring the projector closer.",
)
CHECKED_FLICKER = FindingKind(
    "check-flicker",
    "What scan check says of changes of brightness between frames.",
    "Expose for whole refresh periods of the projector, and switch off other lamps.",
)
CHECKED_GHOST = FindingKind(
    "check-ghost",
    "What scan check says of how much of the picture before a frame still shows.",
    "Let the camera wait longer for the projector.",
)


def brightest_channel(image: Image) -> Image:
    """(H, W): where one colour is clipped, the pixel is."""
    return image.max(axis=2) if image.ndim == 3 else image


def _mean(images: Sequence[Image]) -> Floats:
    total = grey(images[0]).copy()
    for image in images[1:]:
        total += grey(image)
    return total / len(images)


@dataclass(frozen=True)
class Light:
    """Frames of white and of black pictures, two or more of each; `highest` is the largest level of a pixel.

    In the first frame of each there may be something of the picture before: it is in no mean.
    """

    white: tuple[Image, ...]
    black: tuple[Image, ...]
    highest: int

    @cached_property
    def mean_white(self) -> Floats:
        """(H, W) in grey levels."""
        return _mean(self.white[1:])

    @cached_property
    def mean_black(self) -> Floats:
        """(H, W) in grey levels."""
        return _mean(self.black[1:])

    @cached_property
    def lit(self) -> Bools:
        """Return where the projector's light falls directly, (H, W), judged by brightness; nowhere if all is noise."""
        contrast = self.mean_white - self.mean_black
        bright = float(np.percentile(contrast, _BRIGHT_PERCENTILE))
        difference = (grey(self.black[-1]) - grey(self.black[-2])).reshape(-1)
        noise = max(1.0, robust_sigma(difference - np.median(difference)))
        return contrast > max(_DIRECT * bright, _SEEN * noise)

    @cached_property
    def clipped(self) -> Bools:
        """(H, W): lit, and as bright as can be in a white frame."""
        peak = np.max([brightest_channel(image) for image in self.white], axis=0)
        clipped: Bools = (peak >= CLIPPED * self.highest) & self.lit
        return clipped

    @property
    def well_lit(self) -> Bools:
        """(H, W): lit and nowhere clipped."""
        return self.lit & ~self.clipped


def photograph_light(rig: Rig, whites: int, blacks: int) -> Light:
    """Take this many frames of white, then of black. Raises DeviceError."""
    width, height = rig.projector.size
    pictures = [np.full((height, width), level, np.uint8) for level in (255, 0)]
    frames = list(rig.photograph([pictures[0]] * whites + [pictures[1]] * blacks))
    images = tuple(frame.image for frame in frames)
    return Light(images[:whites], images[whites:], rig.camera.highest_level)


def light_rows(light: Light) -> Iterator[CheckRow]:
    """Ambient light, flicker and ghost, if anything is lit."""
    if light.well_lit.any():
        yield _ambient(light)
        yield _flicker(light)
        yield _ghost(light)


def ambient_share(light: Light) -> float:
    """Median brightness of a black frame relative to a white one, where the projector's light falls."""
    return float(np.median(light.mean_black[light.well_lit] / light.mean_white[light.well_lit]))


def _ambient(light: Light) -> CheckRow:
    """Grade ambient light, which takes range from the fringes and adds shot noise.

    If the white level is held just below saturation, a share a of ambient light reduces the amplitude to 1 − a of its
    value in darkness. The noise is at most that of the white level.
    """
    share = ambient_share(light)
    finding = f"a black picture is {100 * share:.1f} % as bright as a white one"
    if 1 - share >= LEAST_AMPLITUDE:
        return CheckRow("ambient light", Finding(CHECKED_AMBIENT_LIGHT, Severity.NOTE, finding))
    return CheckRow(
        "ambient light",
        Finding(
            CHECKED_AMBIENT_LIGHT,
            Severity.WARNING,
            finding,
            "Darken the room, or use a brighter projector; then check the exposure again.",
        ),
    )


@dataclass(frozen=True)
class Flicker:
    """Standard deviations of the brightness of frames of one picture, relative to white: of `white` and of `black`."""

    white: float
    black: float


def flicker_of(light: Light) -> Flicker:
    """Relative difference of frames of the same picture; pixel noise averages out.

    The first frame of each picture is excluded if there are enough.
    """
    level = float(light.mean_white[light.well_lit].mean())
    spreads = [
        float(np.std([grey(image)[light.well_lit].mean() for image in images[-max(2, len(images) - 1) :]], ddof=1))
        / level
        for images in (light.white, light.black)
    ]
    return Flicker(*spreads)


def _flicker(light: Light) -> CheckRow:
    flicker = flicker_of(light)
    finding = f"white frames differ by {100 * flicker.white:.2g} %"
    if flicker.white <= MUCH_FLICKER:
        return CheckRow("flicker", Finding(CHECKED_FLICKER, Severity.NOTE, finding))
    if TOLERATED_LOSS * flicker.black >= flicker.white:
        advice = "Black frames do so as well: turn off lamps on the mains, or expose for whole periods of it."
    else:
        advice = (
            "Black frames do not: the projector's light pulsates (colour wheel, dimmed lamp). Expose for whole refresh "
            "periods, better for several; turn off dynamic contrast and eco mode."
        )
    return CheckRow("flicker", Finding(CHECKED_FLICKER, Severity.WARNING, finding, advice))


def ghost_of(light: Light) -> float:
    """The share of white that is still there in the first black frame after it, but not in those after."""
    where = light.well_lit
    white, first, black = (image[where].mean() for image in (light.mean_white, grey(light.black[0]), light.mean_black))
    return float((first - black) / (white - black))


def leaves_ghost(light: Light) -> bool:
    """Whether ghosting is so strong that measurements from single frames are wrong."""
    return ghost_of(light) > _MOST_GHOST


def _ghost(light: Light) -> CheckRow:
    finding = f"{100 * max(ghost_of(light), 0.0):.1f} % of the picture before is left in a frame"
    if not leaves_ghost(light):
        return CheckRow("ghost", Finding(CHECKED_GHOST, Severity.NOTE, finding))
    return CheckRow(
        "ghost",
        Finding(
            CHECKED_GHOST,
            Severity.WARNING,
            finding,
            "The panel is slow: turn off noise reduction, motion smoothing and power saving in the projector's menu, "
            "and let it warm up; with a longer exposure less is left, and most DLP projectors leave nothing.",
        ),
    )


Shown = TypeVar("Shown")
Observed = TypeVar("Observed")


def settled(
    show: Callable[[Iterator[Shown]], Iterable[Observed]], pictures: Sequence[Shown], light: Light | None = None
) -> Iterator[Observed]:
    """What `show` sees of each picture when it has settled; one frame of each will do where `light` knows no ghost."""
    times = 2 if light is None or leaves_ghost(light) else 1
    repeated = (picture for picture in pictures for _ in range(times))
    yield from islice(show(repeated), times - 1, None, times)
