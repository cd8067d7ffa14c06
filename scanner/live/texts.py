"""Texts about live clouds."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scanner.decoding import MaskReason
from scanner.live.cloud import LiveCloud
from scanner.live.watching import Account
from scanner.quantities import percent, shown_unit

_MANY_SATURATED, _FEW_LIT, _ALL_MOVES = 0.02, 0.1, 0.5


def cloud_text(cloud: LiveCloud, unit: str) -> str:
    """Number of points, and their accuracy."""
    sigma = shown_unit(unit).error(float(np.median(cloud.sigma))) if len(cloud.points) else "-"
    return f"{len(cloud.points):,} points, sigma {sigma}"


def advice(cloud: LiveCloud) -> Iterator[str]:
    """Sentences on what should be otherwise."""
    saturated = cloud.share(MaskReason.SATURATED)
    if saturated > _MANY_SATURATED:
        yield f"{percent(saturated)} of what is lit is overexposed: shorten the exposure, or close the aperture."
    if cloud.lit < _FEW_LIT * cloud.reason.size:
        yield f"Only {percent(cloud.lit / cloud.reason.size)} of the pixels see the fringes: more light, or closer."
    if cloud.moving_share > _ALL_MOVES:
        yield "Nearly everything moves: hold still for a moment."


def round_texts(cloud: LiveCloud | None, account: Account, unit: str) -> list[str]:
    """Texts about the newest round, with or without a cloud."""
    if cloud is None:
        return ["No cloud this time: the scene or the rig moved between frames. Waiting for it to rest."]
    left_out = cloud.share(MaskReason.INCONSISTENT, MaskReason.MOVED, MaskReason.ISOLATED)
    rate = f"{account.rate_hz:.1f} clouds a second" if account.rate_hz else "The first cloud"
    return [
        f"{rate}, {1000 * account.delay_s:.0f} ms after its last frame; {cloud_text(cloud, unit)}; "
        f"{percent(cloud.moving_share)} moves, {percent(left_out)} is left out.",
        *advice(cloud),
    ]


def result_texts(kept: int, out: Path, config: Path, calibration: Path, *, of_room: bool = False) -> Iterator[str]:
    """Where kept clouds are, and the one next step."""
    yield f"Result: {out} ({kept} {'station' if kept == 1 else 'stations'} in captures)"
    if kept > 1:
        kind = "room" if of_room else "object"
        yield (
            f"→ scan {kind} {out} --config {config} --calibration {calibration} --out {out}-{kind} puts them together."
        )


def account_text(account: Account) -> str:
    """What became of the rounds."""
    parts = [f"{account.clouds} clouds"]
    for count, what in (
        (account.lost, "lost a frame"),
        (account.contradicting, "had frames that contradict each other"),
        (account.skipped, "came while others were decoded"),
    ):
        if count:
            parts.append(f"{count} rounds {what}")
    return f"{', '.join(parts)}."
