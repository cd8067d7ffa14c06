"""What the operator should know about a capture that decodes, but could be better."""

from collections.abc import Iterator

from scanner.decoding.arrays import Reasons
from scanner.decoding.mask_reasons import MaskReason, count_reasons

_LOW_MODULATION = 0.2
_LARGE_SHARE = 0.1
_FEW_MATCHED = 0.02
# One per cent shifts a fringe of four steps by up to a six-hundredth of its period.
MUCH_FLICKER = 0.01


def warnings_of(reasons: Reasons, modulation: float | None, flicker: float | None) -> Iterator[str]:
    """Sentences about the `reasons` (H, W) of all pixels, the `modulation` of the finest fringes, and the `flicker`."""
    count = count_reasons(reasons, tuple(MaskReason))
    matched, dark = count[MaskReason.KEPT], count[MaskReason.DARK]
    lit = max(1, reasons.size - dark)
    if matched < _FEW_MATCHED * reasons.size:
        yield f"Only {matched / reasons.size:.1%} of the camera's pixels have a match: does the camera see the light?"
    if count[MaskReason.SATURATED] > _LARGE_SHARE * lit:
        yield f"{count[MaskReason.SATURATED] / lit:.0%} of the lit pixels are saturated: shorten the exposure."
    if count[MaskReason.INCONSISTENT] > _LARGE_SHARE * lit:
        yield (
            f"At {count[MaskReason.INCONSISTENT] / lit:.0%} of the lit pixels the frames contradict each other: "
            "interreflection, or something moved."
        )
    if flicker is not None and flicker > MUCH_FLICKER:
        yield (
            f"The brightness of the frames varies by {flicker:.1%}, which was taken out as far as the frames tell it. "
            "Better: expose for whole periods of the projector's refresh, which are also whole turns of its colour "
            "wheel, and shut out other lamps."
        )
    if modulation is not None and modulation < _LOW_MODULATION:
        yield (
            f"The finest fringes are faint, {modulation:.0%} of the mean brightness: focus camera and projector, "
            "darken the room, or use a longer period."
        )
