"""Findings on a refined solution: its assumptions, the gain of a further view, and misfit."""

from collections.abc import Iterator

import numpy as np

from calib.diagnostics.acceptance import (
    allowed_deg,
    far_from_square,
    named_angles,
    on_picture_scale,
    on_repeats,
    sigma_if,
)
from calib.diagnostics.next_best_view import NextView
from calib.finding import Finding, FindingKind, Severity
from calib.refinement import CAMERA, WEAK_TERMS, Knowledge, Refinement

_LOPSIDED = 0.15  # asymmetry relative to the interval's length
_MOST, _WORTH_TELLING = 0.7, 0.002  # largest share of the sigma; least share of the focal length
_EXACTLY = 1e-7  # standard deviation of a lens term that is known
WORTH_A_CAPTURE = 0.7  # of the sigma without it

EXACTLY_SQUARE = FindingKind(
    "exactly-square",
    "The corner was taken as exactly square; walls that are not move the focals, which the sigmas do not contain.",
    "Leave corner.squareness_deg out unless the corner is a precision cube.",
)
OFF_SQUARE = FindingKind(
    "off-square",
    "How far the faces seem to be from square, within what was allowed.",
    data=("allowed_deg", "off_square_deg"),
)
FAR_FROM_SQUARE = FindingKind(
    "far-from-square",
    "The corner is farther from square than was allowed for; its angles were used as measured.",
    "If its walls are square, check the camera's principal point and the projector's keystone correction.",
    ("allowed_deg", "off_square_deg"),
)
DIFFERENT_CORNERS = FindingKind(
    "different-corners",
    "The captures do not show the same corner, or something in it moved; each was given its own angles.",
    "Capture the same corner from other places, or set corner.same to false.",
    ("cost", "limit"),
)
LOPSIDED_INTERVAL = FindingKind(
    "lopsided-interval",
    "The interval of the camera's focal length is not symmetric.",
    data=("focal_px", "low_px", "high_px"),
)
LENS_LIMITED = FindingKind(
    "lens-limited",
    "Most of the uncertainty comes from the distortion of the lenses, which one capture hardly measures.",
    "Capture the corner from another place as well, or use a calibration by boards (lens: {from: calibration.yaml}).",
    ("sigma_percent", "of_lenses_percent"),
)
FURTHER_CAPTURE = FindingKind(
    "further-capture",
    "A further capture of this corner would lower the sigmas much.",
    "Move the rig as the message says, and capture the corner again.",
    ("sigma_percent", "expected_percent"),
)
SMOOTH_RESIDUALS = FindingKind(
    "smooth-residuals",
    "The faces show small waves, as lenses make them; the sigmas contain that.",
    data=("captures", "inflation_ratio"),
)
OUTLIERS = FindingKind(
    "outliers",
    "Some of the matches on the faces fit no plane, and were left out.",
    data=("captures", "outlier_share"),
)


def findings_on_solution(
    refinement: Refinement, knowledge: Knowledge, further: NextView | None = None
) -> tuple[Finding, ...]:
    """Findings on assumptions and whether the data support them, on the gain of a `further` view, and on misfit."""
    return (
        *_on_squareness(refinement, knowledge),
        *on_repeats(refinement),
        *on_picture_scale(refinement),
        *_on_interval(refinement),
        *_on_lenses(refinement),
        *_on_next_view(refinement, further),
        *_on_noise(refinement, knowledge),
    )


def _on_squareness(refinement: Refinement, knowledge: Knowledge) -> Iterator[Finding]:
    if knowledge.squareness_deg == 0:
        yield Finding(
            EXACTLY_SQUARE,
            Severity.NOTE,
            "The corner was taken as exactly square: 0.1 degrees off would move the focals by 1 to 3 %, "
            "which the sigmas do not contain.",
        )
        return
    off = np.degrees(refinement.fit.state.off_square)
    allowed = allowed_deg(refinement)
    angles = {"allowed_deg": allowed, "off_square_deg": float(np.abs(off).max())}
    yield Finding(
        OFF_SQUARE,
        Severity.NOTE,
        f"The faces were allowed to be off square by {allowed:g}° (1 sigma); they seem to be off by "
        f"{'; '.join(map(named_angles, off))}.",
        data=angles,
    )
    if far_from_square(refinement):
        yield Finding(
            FAR_FROM_SQUARE,
            Severity.NOTE,
            "This corner is farther from square than expected. The matches determine its angles, so they were used as "
            "measured.",
            FAR_FROM_SQUARE.remedy,
            angles,
        )
    sameness = refinement.sameness
    if sameness and not sameness.same:
        yield Finding(
            DIFFERENT_CORNERS,
            Severity.NOTE,
            f"These captures do not show the same corner: with shared angles, −2 log likelihood is higher by "
            f"{sameness.cost:.0f}, where chance explains at most {sameness.limit:.0f}. Each was given its own angles.",
            data={"cost": sameness.cost, "limit": sameness.limit},
        )


def _on_interval(refinement: Refinement) -> Iterator[Finding]:
    """A note if the likelihood along the focal length is asymmetric."""
    focal, (low, high) = refinement.fit.state.camera[0], refinement.valley.interval_px
    if abs((high - focal) - (focal - low)) >= _LOPSIDED * (high - low):
        yield Finding(
            LOPSIDED_INTERVAL,
            Severity.NOTE,
            f"The camera's focal length, {focal:.0f} px, is between {low:.0f} and {high:.0f} px with 68 % probability.",
            data={"focal_px": float(focal), "low_px": float(low), "high_px": float(high)},
        )


def _on_lenses(refinement: Refinement) -> Iterator[Finding]:
    """A note if the lens terms cause most of the uncertainty."""
    sigma = _focal_sigma(refinement)
    every, lenses = sigma_if(refinement, {}), sigma_if(refinement, dict.fromkeys(WEAK_TERMS, _EXACTLY))
    share = float(np.sqrt(max(1 - (lenses / every) ** 2, 0.0)))
    if share >= _MOST and sigma >= _WORTH_TELLING:
        yield Finding(
            LENS_LIMITED,
            Severity.NOTE,
            f"Of the {100 * sigma:.2g} % of the camera's focal length (one sigma), {100 * share * sigma:.2g} % come "
            "from the distortion of both lenses, which one capture hardly measures.",
            LENS_LIMITED.remedy,
            {"sigma_percent": 100 * sigma, "of_lenses_percent": 100 * share * sigma},
        )


def _on_next_view(refinement: Refinement, view: NextView | None) -> Iterator[Finding]:
    """A note on the gain of a further capture, if it is worthwhile."""
    sigma = _focal_sigma(refinement)
    if view is not None and view.sigma <= WORTH_A_CAPTURE * sigma:
        yield Finding(
            FURTHER_CAPTURE,
            Severity.NOTE,
            f"A further capture of this corner, the rig moved {view.words}, would lower the sigma of the camera's "
            f"focal length from {100 * sigma:.2g} % to about {100 * view.sigma:.2g} %.",
            data={"sigma_percent": 100 * sigma, "expected_percent": 100 * view.sigma},
        )


def _focal_sigma(refinement: Refinement) -> float:
    """Relative standard deviation of the camera's focal length."""
    return float(np.sqrt(refinement.covariance[CAMERA.start, CAMERA.start]))


def _on_noise(refinement: Refinement, knowledge: Knowledge) -> Iterator[Finding]:
    for i, (cells, noise) in enumerate(zip(refinement.captures, refinement.noise, strict=True)):
        of = f"{knowledge.words.taken.capitalize()} {i + 1}: " if len(refinement.captures) > 1 else ""
        if noise.inflation > 1:
            ratio = float(np.sqrt(noise.inflation))
            yield Finding(
                SMOOTH_RESIDUALS,
                Severity.NOTE,
                f"{of}The faces show small waves ({ratio:.1f} × noise). Already in the ±; nothing to do.",
                data={"captures": (i + 1,), "inflation_ratio": ratio},
            )
        if cells.rejected > 0.01:
            yield Finding(
                OUTLIERS,
                Severity.NOTE,
                f"{of}{100 * cells.rejected:.1f} % of the matches on the faces were left out as outliers.",
                data={"captures": (i + 1,), "outlier_share": cells.rejected},
            )
