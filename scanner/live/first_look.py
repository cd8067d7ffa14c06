"""What has to be known of a rig before its live image: the response to be undone, noise, and how bright fringes are."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.finding import FindingKind
from calib.numerics import Bools, Image, grey
from calib.refusal import RefusalError
from hw.rig import Rig
from scanner.checking import Light, measure_ramp, photograph_light
from scanner.configuration import Config
from scanner.patterns import ProjectorResponse

_WHITES, _BLACKS = 4, 3
_ROUNDING = 1 / 12
# Larger squared differences are left out: 3.5 standard deviations, which removes 0.2 % of a normal distribution.
_MOST_SIGMAS = 3.5
_LEAST_LIT = 500

NO_LIGHT = FindingKind(
    "no-light",
    "The camera sees next to nothing of the projector's light.",
    "Point both at the same thing; check lens cap, exposure and focus (scan check), and that the projector is on.",
)


@dataclass(frozen=True)
class FirstLook:
    """What is known of a rig before its live image. The variance of a pixel at level I is `noise[0]` + `noise[1]` I."""

    lit: Bools
    """Pixels lit by the projector, (H, W)."""
    noise: tuple[float, float]
    saturated: float
    """The level of saturation."""
    response: ProjectorResponse | None
    """From drawn levels to observed ones, None if unknown."""


def look(rig: Rig, config: Config) -> FirstLook:
    """Photograph white, black and, without a configured response, a ramp of grey pictures.

    With three steps, a nonlinear response shifts a fringe by up to a twentieth of a cycle. So the response of projector
    and camera together is measured. Raises DeviceError; RefusalError if nothing is lit.
    """
    light = photograph_light(rig, _WHITES, _BLACKS)
    lit = light.well_lit
    if np.count_nonzero(lit) < _LEAST_LIT:
        raise RefusalError(
            NO_LIGHT,
            "The camera sees next to nothing of the projector's light.",
            "Point both at the same thing, and check exposure and focus with scan check.",
        )
    response = config.projector.known_response
    if response is None and (ramp := measure_ramp(rig, light)) is not None:
        response = ramp.response
    return FirstLook(lit, noise_of(light), 0.99 * light.highest, response)


def noise_of(light: Light) -> tuple[float, float]:
    """Variance of a pixel at level 0, and its increase per level, from differences of frames of one picture."""
    white, black = (_variance(images[1:], light.well_lit) for images in (light.white, light.black))
    gain = max(0.0, (white[1] - black[1]) / max(1.0, white[0] - black[0]))
    return max(_ROUNDING, black[1] - gain * black[0]), gain


def _variance(images: tuple[Image, ...], where: Bools) -> tuple[float, float]:
    """Mean level and variance of a pixel; what moved between two frames does not count."""
    grey_levels = [grey(image)[where] for image in images]
    levels, variances = [], []
    for first, second in pairwise(grey_levels):
        squares = (second - first - np.mean(second - first)) ** 2
        usual = float(np.mean(squares))
        for _ in range(5):
            usual = float(np.mean(squares[squares <= _MOST_SIGMAS**2 * max(usual, _ROUNDING)]))
        levels.append(float(np.mean(first)))
        variances.append(usual / 2)
    return float(np.mean(levels)), float(np.mean(variances))
