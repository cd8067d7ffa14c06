"""The catalogue of conditions, each with increasing strength."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any, get_args

import numpy as np

from conditions.captures import Inverses, bits_alone, bits_in_order, long_fringe, long_fringes, xor_along_x, xor_code
from conditions.changes import (
    OfFrames,
    Random,
    compressed,
    developed,
    each_exposed,
    exchanged,
    finest_bit_twice,
    inverted,
    late,
    late_rows,
    one_frame,
    phone,
    repeated,
    resampled,
    shaken,
    stated,
    swapped,
    tone_mapped,
)
from hw.simulated import SimulatedRoom
from scanner.patterns import Axis, Pattern

# The room of all conditions has 0.05; white in the camera's range reaches 0.85.
AMBIENT = 0.05
OfRig = Mapping[str, Any] | Callable[[Sequence[Pattern], Random], Mapping[str, Any]]


@dataclass(frozen=True)
class Condition:
    """`rig`: settings of the simulated rig, or a function that draws them for a sequence; `exposure`: relative to the
    suitable one of the room; `frames`: a change of the frames.

    `moves`: devices move, which only one of the axes sees. `fault`: a mistake rather than a property of a device; it
    may always be refused. `shown`: for a projector of (width, height), patterns that replace the sequence; along one
    axis only, the calibration is given. `imported`: the capture goes through `scan import`, as frames without a list.
    """

    name: str
    strength: str = ""
    rig: OfRig = field(default_factory=dict)
    exposure: float | Callable[[SimulatedRoom], float] = 1.0
    frames: OfFrames | None = None
    moves: bool = False
    fault: bool = False
    shown: Callable[[tuple[int, int]], tuple[Pattern, ...]] | None = None
    imported: bool = False

    def exposed(self, room: SimulatedRoom) -> float:
        """The exposure relative to the suitable one of the room."""
        return self.exposure(room) if callable(self.exposure) else self.exposure

    def settings(self, patterns: Sequence[Pattern], rng: Random) -> dict[str, Any]:
        """The rig's settings, for a capture of some patterns."""
        return dict(self.rig(patterns, rng) if callable(self.rig) else self.rig)


def conditions() -> Iterator[Condition]:
    """All conditions."""
    yield Condition("nothing")
    yield from _light()
    yield from _optics()
    yield from _camera()
    yield from _scene()
    yield from _motion()
    yield from _picture()
    yield from _frames()
    yield from _sequences()


def _light() -> Iterator[Condition]:
    for percent in (2, 5, 10, 15, 30):
        yield Condition("flicker", f"{percent} %", {"flicker": percent / 100})
    for percent in (5, 15):
        bands = {"flicker": percent / 100, "rolling_shutter_ms": 40.0}
        yield Condition("bands of a rolling shutter", f"{percent} %", bands)
    for share in (0.0, 0.25, 0.5, 0.75, 0.95):
        yield Condition("light switched on, +10 % of white", f"after {share:.0%}", _switched(share, 0.1))
    yield Condition("light switched on, +30 % of white", "after 50%", _switched(0.5, 0.3))
    for factor in (0.6, 1.4):
        yield Condition("one frame brighter or darker", f"× {factor}", frames=one_frame(factor))
    yield Condition("each frame exposed differently", "up to × 3", frames=each_exposed(3.0))


def _optics() -> Iterator[Condition]:
    for percent in (10, 20, 30, 40):
        yield Condition("light lost by fine stripes", f"{percent} %", {"stripe_loss": percent / 100})
    for gamma in (1.0, 1.8, 2.6, 3.0):
        yield Condition("gamma of the projector", f"{gamma}", {"gamma": gamma})
    for blur in (1.0, 2.0, 3.0, 4.0):
        yield Condition("projector out of focus", f"{blur:g} px", {"projector_blur_px": blur})
    for sharpening in (0.5, 1.0, 2.0):
        yield Condition("sharpening", f"{sharpening}", {"sharpening": sharpening})
    for percent in (10, 30):
        yield Condition("ghost of the last picture", f"{percent} %", {"ghost": percent / 100})


def _camera() -> Iterator[Condition]:
    for response in ("srgb", "photo"):
        yield Condition("camera's response", response, {"camera_response": response})
    for contrast, blur in product((0.0, 1.0, 1.5), (0.5, 1.0, 1.5)):
        photographs = {"bit_depth": 16, "camera_blur_px": blur}
        strength, frames = f"S-curve of {contrast:g}, blur of {blur:g} px", developed(contrast, 90)
        yield Condition("tone curve of photographs", strength, photographs, frames=frames)
        yield Condition("tone curve, no inverses", strength, photographs, frames=frames, shown=bits_alone)
    for blur in (1.0, 2.0, 3.0):
        yield Condition("camera out of focus", f"{blur:g} px", {"camera_blur_px": blur})
    for darker in (2, 4, 8):
        yield Condition("darker", f"1/{darker}", exposure=1 / darker)
    for percent in (10, 30):
        yield Condition("saturated in white", f"{percent} % of lit pixels", exposure=_saturating(percent / 100))
    for quality in (95, 85, 70, 50):
        yield Condition("JPEG", f"quality {quality}", frames=compressed(quality))
    yield Condition("JPEG", "quality 85, colour, 4:2:0", frames=compressed(85, tint=(0.7, 1.0, 0.85)))
    yield Condition("noise reduction and sharpening", "of a phone", frames=phone)
    yield Condition("local tone mapping", "of a phone", frames=tone_mapped)
    yield Condition("frames blurred by motion", "4 px", frames=shaken(4.0))
    yield Condition("frames stabilised", "by (0.24, 0.18) px", frames=resampled((0.24, 0.18)))
    yield Condition("frames stabilised", "each by up to 0.25 px", frames=resampled(0.25), moves=True)
    yield Condition("camera of 12 bits", "20 × as many electrons", {"bit_depth": 12, "full_well_electrons": 210_000.0})


def _scene() -> Iterator[Condition]:
    for width in (0.1, 0.2, 0.4):
        yield Condition("somebody goes past", f"{width} m wide", _passing(width))
    for width in (0.1, 0.3):
        for by in (0.01, 0.05, 0.3, 2.0):
            yield Condition("a box is pushed", f"{width} m wide, by {by} m", _pushed(width, by))
    for angle in (2.0, 5.0):
        yield Condition("furniture askew", f"{angle:g}°", {"furniture_askew_deg": angle})


def _motion() -> Iterator[Condition]:
    for device in ("camera", "projector"):
        for place, when in (("between the axes", _first_of_y), ("within an axis", _within_an_axis)):
            for px in (0.3, 1.0, 3.0, 10.0):
                yield Condition(f"{device} bumped {place}", f"{px:g} px", _bumped(device, px, when), moves=True)
    for device in ("camera", "projector"):
        for px in (0.3, 1.0, 3.0):
            yield Condition(f"{device} drifts over the capture", f"{px:g} px", _drifting(device, px), moves=True)


def _picture() -> Iterator[Condition]:
    yield Condition("picture mirrored", rig={"panel": {"mirrored": True}})
    yield Condition("picture scaled", "80 %", {"panel": {"scale": 0.8}})
    for percent in (103, 105, 120):
        yield Condition("picture cropped", f"of {percent} %", {"panel": {"scale": percent / 100}})
    yield Condition("picture squeezed", "75 %", {"panel": {"squeeze": 0.75}})
    for percent in (1, 2, 5, 20):
        yield Condition("keystone", f"{percent} %", {"panel": {"keystone": percent / 100}})
    for factor in (0.9, 1.1):
        yield Condition("projector's size stated", f"× {factor}", frames=stated(factor), fault=True)
    yield Condition("projector's size stated", "swapped", frames=swapped, fault=True)


def _frames() -> Iterator[Condition]:
    yield Condition("projector late in one frame", "half of it", frames=late(0.5))
    yield Condition("projector late in one frame", "all of it", frames=late(1.0), fault=True)
    for which in ("lower", "every second"):
        yield Condition("rows with 25 % of the picture before", which, frames=late_rows(0.25, which))
    yield Condition("finest bit shown twice", frames=finest_bit_twice, fault=True)
    yield Condition("two frames exchanged", frames=exchanged, fault=True)
    yield Condition("one frame repeated", frames=repeated, fault=True)
    yield Condition("a bit and its inverse exchanged", frames=inverted, fault=True)


def _sequences() -> Iterator[Condition]:
    for gamma in (1.0, 1.8, 2.6, 3.0):
        yield Condition("one long fringe, calibrated rig", f"gamma {gamma}", {"gamma": gamma}, shown=long_fringe)
        yield Condition("one long fringe along each axis", f"gamma {gamma}", {"gamma": gamma}, shown=long_fringes)
    axes: tuple[Axis, ...] = ("x", "y")
    for axis, finest_first, inverses in product(axes, (False, True), get_args(Inverses)):
        shown = partial(bits_in_order, axis=axis, finest_first=finest_first, inverses=inverses)
        order = f"{'finest' if finest_first else 'coarsest'} bit first, inverses {inverses}"
        yield Condition(f"imported, {axis} only", order, shown=shown, imported=True)
    for above in (0, 2):
        xor = partial(xor_along_x, above_finest=above)
        name = f"base {above} above the finest"
        yield Condition("imported, an XOR code along x", name, shown=xor, imported=True, fault=True)
    for above in (0, 1, 2, 4):
        yield Condition("XOR code", f"base {above} above the finest", shown=partial(xor_code, above_finest=above))


def _saturating(share: float) -> Callable[[SimulatedRoom], float]:
    def exposure(room: SimulatedRoom) -> float:
        optics = room.room.projector.optics
        white = room.electrons(np.full((optics.height, optics.width), 255, np.uint8))
        lit = room.renderer.direct(np.ones((optics.height, optics.width), np.float32)) > 0
        return room.sensor.full_well_electrons / float(np.quantile(white[lit], 1 - share))

    return exposure


def _switched(share: float, more: float) -> OfRig:
    # White and black come first and are never between two other frames.
    return lambda patterns, _: {"light": {"frame": round(2 + share * (len(patterns) - 2)), "ambient": AMBIENT + more}}


def _passing(width_m: float) -> OfRig:
    def settings(patterns: Sequence[Pattern], rng: Random) -> dict[str, Any]:
        first = int(rng.integers(2, len(patterns) - 6))
        return {"passer": {"width_m": width_m, "first_frame": first, "last_frame": first + 5}}

    return settings


def _pushed(width_m: float, by_m: float) -> OfRig:
    def settings(patterns: Sequence[Pattern], rng: Random) -> dict[str, Any]:
        return {"pushed": {"width_m": width_m, "by_m": by_m, "frame": int(rng.integers(2, len(patterns)))}}

    return settings


def _first_of_y(patterns: Sequence[Pattern], _: Random) -> int:
    return next(number for number, pattern in enumerate(patterns) if getattr(pattern, "axis", "") == "y")


def _within_an_axis(patterns: Sequence[Pattern], rng: Random) -> int:
    return int(rng.choice([n for n in range(4, len(patterns)) if n != _first_of_y(patterns, rng)]))


def _bumped(device: str, px: float, when: Callable[[Sequence[Pattern], Random], int]) -> OfRig:
    def settings(patterns: Sequence[Pattern], rng: Random) -> dict[str, Any]:
        frame = when(patterns, rng)
        return {"bump": {"device": device, "frame": frame, "px": px, "direction_deg": float(rng.uniform(0, 360))}}

    return settings


def _drifting(device: str, px: float) -> OfRig:
    def settings(patterns: Sequence[Pattern], rng: Random) -> dict[str, Any]:
        step = px / (len(patterns) - 1)
        return {"drift": {"device": device, "px_per_frame": step, "direction_deg": float(rng.uniform(0, 360))}}

    return settings
