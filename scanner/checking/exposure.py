"""Which exposure uses the camera's range well, and nowhere more than that."""

from dataclasses import dataclass
from math import floor

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import grey, robust_sigma
from hw.rig import Rig, settable_exposure
from scanner.checking.light import CLIPPED, Light, flicker_of, photograph_light
from scanner.checking.report import LEAST_SHARE, CheckRow
from scanner.decoding import MUCH_FLICKER

_NAME = "exposure"
# Specular spots may clip: this share of the lit pixels is masked without loss.
_SPARED = 0.001
# Margin below saturation, in standard deviations of the shot noise of the brightest pixels.
_HEADROOM_SIGMAS = 4.0
# If the picture is clipped, the excess is unknown: the next trial uses this share of the exposure.
_LESS = 0.25
# If nothing is seen, the next trial uses this multiple.
_MORE = 4.0
_ROUNDS = 8
# Share of a refresh period: cameras set whole microseconds.
_ROUNDING = 0.001
_WHITES, _BLACKS = 4, 2
# Relative difference below which an exposure counts as unchanged.
_SAME = 0.02
# A longer exposure makes a scan of 44 frames last over a minute; aperture or gain are better.
_LONGEST_US = 1e6
_BY_HAND = "Set the camera's exposure by hand, in its driver's tool or its app: the program cannot."

CHECKED_EXPOSURE = FindingKind(
    "check-exposure",
    "What scan check says of the exposure.",
    "scan check --write sets the proposed one; otherwise change aperture, gain or distance.",
)


@dataclass(frozen=True)
class ExposureLevels:
    """What a white picture looks like at an exposure: the share of the lit pixels that are clipped, and the level of
    the brightest of the others, relative to the highest; NaN where nothing is lit. `headroom`: what noise needs.
    `flicker`: how much white frames differ.
    """

    exposure_us: float
    clipped: float
    brightest: float
    headroom: float
    flicker: float = 0.0

    @property
    def is_clipped(self) -> bool:
        """More than shiny spots."""
        return self.clipped > _SPARED

    @property
    def is_dark(self) -> bool:
        """Whether nothing is lit."""
        return bool(np.isnan(self.brightest)) and not self.is_clipped


@dataclass(frozen=True)
class Proposal:
    """The exposure to use, None if the camera cannot make it; the looks at the `first` and at the `last` one tried.

    `settable`: whether others could be tried.
    """

    exposure_us: float | None
    first: ExposureLevels
    last: ExposureLevels
    settable: bool = True


def exposure_levels(light: Light, exposure_us: float) -> ExposureLevels:
    """Measure the exposure of white and black frames."""
    lit = int(light.lit.sum())
    if lit == 0:
        everything = float(np.median(light.mean_white) >= CLIPPED * light.highest)  # black pictures are white, too
        return ExposureLevels(exposure_us, everything, float("nan"), 0.0)
    levels = light.mean_white[light.lit]
    brightest = float(np.quantile(levels, 1 - _SPARED))
    bright = light.well_lit & (light.mean_white > LEAST_SHARE * brightest)
    noise = 0.0
    if bright.any():
        difference = grey(light.white[1])[bright] - grey(light.white[0])[bright]
        noise = robust_sigma(difference - np.median(difference)) / float(np.sqrt(2))
    return ExposureLevels(
        exposure_us,
        float(light.clipped.sum()) / lit,
        brightest / light.highest,
        _HEADROOM_SIGMAS * noise / light.highest,
        flicker_of(light).white if light.well_lit.any() else 0.0,
    )


def propose_exposure(rig: Rig) -> Proposal:
    """Try exposures until one suits; the camera is left at it. Raises DeviceError.

    A camera whose exposure cannot be changed is looked at once.
    """
    camera = settable_exposure(rig.camera)
    if camera is None:
        first = exposure_levels(photograph_light(rig, _WHITES, _BLACKS), 0.0)
        return Proposal(None, first, first, settable=False)
    first = levels = exposure_levels(photograph_light(rig, _WHITES, _BLACKS), camera.exposure_us)
    too_long_us = float("inf")
    for _ in range(_ROUNDS):
        if levels.is_clipped:
            too_long_us = min(too_long_us, levels.exposure_us)
        wanted_us = _next(levels, camera.exposure_limits_us, rig.refresh_hz, too_long_us)
        if abs(wanted_us - levels.exposure_us) <= _SAME * levels.exposure_us:
            break
        exposure_us = camera.expose_for(wanted_us)
        levels = exposure_levels(photograph_light(rig, _WHITES, _BLACKS), exposure_us)
    usable = not (levels.is_clipped or levels.is_dark)
    return Proposal(levels.exposure_us if usable else None, first, levels)


def _next(
    levels: ExposureLevels, limits_us: tuple[float, float], refresh_hz: float | None, too_long_us: float
) -> float:
    """The exposure to try after one that looked like that, within limits and below one that was too long."""
    period_us = 1e6 / refresh_hz if refresh_hz else 0.0
    if levels.is_clipped:
        wanted_us = _LESS * levels.exposure_us
    elif levels.is_dark:
        wanted_us = _MORE * levels.exposure_us
    else:
        wanted_us = levels.exposure_us * (1 - levels.headroom) / levels.brightest
    shortest_us, longest_us = max(limits_us[0], period_us), min(limits_us[1], _LONGEST_US)
    wanted_us = max(shortest_us, min(wanted_us, longest_us, (1 - _SAME) * too_long_us))
    return max(1, floor(wanted_us / period_us + _ROUNDING)) * period_us if period_us else wanted_us


def exposure_row(proposal: Proposal, refresh_hz: float | None, *, bracketed: bool) -> CheckRow:
    """Grade the configured exposure and propose a better one; `bracketed`: the sequence has its own exposures."""
    first = proposal.first
    finding = _described(first)
    if first.is_dark and proposal.exposure_us is None:
        return CheckRow(
            _NAME,
            Finding(
                CHECKED_EXPOSURE, Severity.REFUSAL, finding, "Check lens cap, aperture, and that the projector is on."
            ),
        )
    if not proposal.settable:
        well = not first.is_clipped and first.brightest >= LEAST_SHARE * (1 - first.headroom)
        return (
            CheckRow(_NAME, Finding(CHECKED_EXPOSURE, Severity.NOTE, finding))
            if well
            else CheckRow(_NAME, Finding(CHECKED_EXPOSURE, Severity.WARNING, finding, _BY_HAND))
        )
    if proposal.exposure_us is None:
        return CheckRow(_NAME, Finding(CHECKED_EXPOSURE, Severity.WARNING, finding, _beyond_the_camera(proposal.last)))
    better = f"{_shown(proposal.exposure_us, refresh_hz)}: {_described(proposal.last)}"
    if bracketed:
        return CheckRow(
            _NAME,
            Finding(CHECKED_EXPOSURE, Severity.NOTE, f"sequence.exposures_us is used; a single one would be {better}"),
        )
    if first.is_clipped or first.is_dark or first.exposure_us < LEAST_SHARE * proposal.exposure_us:
        return CheckRow(
            _NAME, Finding(CHECKED_EXPOSURE, Severity.WARNING, finding, f"Better {better}. --write sets it.")
        )
    if first.flicker > MUCH_FLICKER > proposal.last.flicker:
        finding = f"{_shown(first.exposure_us, refresh_hz)}, white frames differ by {100 * first.flicker:.2g} %"
        return CheckRow(
            _NAME, Finding(CHECKED_EXPOSURE, Severity.WARNING, finding, f"Better {better}. --write sets it.")
        )
    if proposal.last.brightest < LEAST_SHARE * (1 - proposal.last.headroom) and not _is_coarse(proposal, refresh_hz):
        return CheckRow(
            _NAME,
            Finding(
                CHECKED_EXPOSURE,
                Severity.WARNING,
                f"{better}",
                "Open the aperture or raise the gain: longer ones take too long.",
            ),
        )
    return CheckRow(
        _NAME, Finding(CHECKED_EXPOSURE, Severity.NOTE, f"{_shown(first.exposure_us, refresh_hz)}, {finding}")
    )


def _is_coarse(proposal: Proposal, refresh_hz: float | None) -> bool:
    """Whether the next longer exposure, a refresh period more, would be too long."""
    if refresh_hz is None or proposal.exposure_us is None:
        return False
    longer = 1 + 1e6 / refresh_hz / proposal.exposure_us
    return longer * proposal.last.brightest > 1 - proposal.last.headroom


def _beyond_the_camera(last: ExposureLevels) -> str:
    if last.is_clipped:
        return (
            "Even the shortest exposure for a whole refresh period is too bright: close the aperture, lower the gain."
        )
    return _BY_HAND


def _shown(exposure_us: float, refresh_hz: float | None) -> str:
    if refresh_hz is None:
        return f"{exposure_us / 1e3:.4g} ms"
    periods = exposure_us * refresh_hz / 1e6
    whole = abs(periods - round(periods)) < _SAME
    count = (
        f"{periods:.0f} refresh period{'' if round(periods) == 1 else 's'}"
        if whole
        else f"{periods:.2g} refresh periods"
    )
    return f"{exposure_us / 1e3:.4g} ms ({count})"


def _described(levels: ExposureLevels) -> str:
    if levels.is_dark:
        return "no difference between a white and a black picture"
    if levels.is_clipped:
        return f"{100 * levels.clipped:.2g} % of what is lit is clipped"
    return f"white reaches {100 * levels.brightest:.0f} % of the range"
