"""Notes on a refined solution, as sentences for the user."""

import numpy as np

from calib.diagnostics.acceptance import far_from_square, on_picture_scale, on_repeats, sigma_if, signed
from calib.diagnostics.next_best_view import NextView
from calib.refinement import CAMERA, WEAK_TERMS, Knowledge, Refinement

# Begin of the note on the gain of a further capture.
FURTHER_CAPTURE = "A further capture of this corner"

# Begin of the note on walls that are farther from square than expected.
FAR_FROM_SQUARE = "This corner is farther from square"

_LOPSIDED = 0.15  # asymmetry relative to the interval's length
_MOST, _WORTH_TELLING = 0.7, 0.002  # largest share of the sigma; least share of the focal length
_EXACTLY = 1e-7  # standard deviation of a lens term that is known
WORTH_A_CAPTURE = 0.7  # of the sigma without it


def notes_on(refinement: Refinement, knowledge: Knowledge, further: NextView | None = None) -> tuple[str, ...]:
    """Notes on assumptions and whether the data support them, on the gain of a `further` view, and on misfit."""
    return (
        *_on_squareness(refinement, knowledge),
        *on_repeats(refinement),
        *on_picture_scale(refinement),
        *_on_interval(refinement),
        *_on_lenses(refinement),
        *_on_next_view(refinement, further),
        *_on_noise(refinement, knowledge),
    )


def _on_squareness(refinement: Refinement, knowledge: Knowledge) -> list[str]:
    if knowledge.squareness_deg == 0:
        return [
            "The corner was taken as exactly square: 0.1 degrees off would move the focals by 1 to 3 %, "
            "which the sigmas do not contain."
        ]
    off = np.degrees(refinement.fit.state.off_square)
    seen = "; ".join(signed(angles) for angles in off)
    notes = [
        f"The faces were allowed to be off square by {knowledge.squareness_deg:g} degrees (1 sigma); they seem to be "
        f"off by {seen} degrees."
    ]
    if far_from_square(refinement, knowledge):
        notes.append(
            f"{FAR_FROM_SQUARE} than expected. The matches determine its angles, so they were used as measured. If its "
            "walls are square, check the camera's principal point and the projector's keystone correction."
        )
    sameness = refinement.sameness
    if sameness and not sameness.same:
        notes.append(
            f"These captures do not show the same corner: with shared angles, −2 log likelihood is higher by "
            f"{sameness.cost:.0f}, where chance explains at most {sameness.limit:.0f}. Each was given its own angles."
        )
    return notes


def _on_interval(refinement: Refinement) -> list[str]:
    """A note if the likelihood along the focal length is asymmetric."""
    focal, (low, high) = refinement.fit.state.camera[0], refinement.valley.interval_px
    if abs((high - focal) - (focal - low)) < _LOPSIDED * (high - low):
        return []
    return [f"The camera's focal length, {focal:.0f} px, is between {low:.0f} and {high:.0f} px with 68 % probability."]


def _on_lenses(refinement: Refinement) -> list[str]:
    """A note if the lens terms cause most of the uncertainty."""
    sigma = _focal_sigma(refinement)
    every, lenses = sigma_if(refinement, {}), sigma_if(refinement, dict.fromkeys(WEAK_TERMS, _EXACTLY))
    share = float(np.sqrt(max(1 - (lenses / every) ** 2, 0.0)))
    if share < _MOST or sigma < _WORTH_TELLING:
        return []
    return [
        f"Of the {100 * sigma:.2g} % of the camera's focal length (one sigma), {100 * share * sigma:.2g} % come from "
        "the distortion of both lenses, which one capture hardly measures: capture the corner from another place as "
        "well, or use a calibration by boards (lens: {from: calibration.yaml})."
    ]


def _on_next_view(refinement: Refinement, view: NextView | None) -> list[str]:
    """A note on the gain of a further capture, if it is worthwhile."""
    sigma = _focal_sigma(refinement)
    if view is None or view.sigma > WORTH_A_CAPTURE * sigma:
        return []
    return [
        f"{FURTHER_CAPTURE}, the rig moved {view.words}, would lower the sigma of the camera's focal "
        f"length from {100 * sigma:.2g} % to about {100 * view.sigma:.2g} %."
    ]


def _focal_sigma(refinement: Refinement) -> float:
    """Relative standard deviation of the camera's focal length."""
    return float(np.sqrt(refinement.covariance[CAMERA.start, CAMERA.start]))


def _on_noise(refinement: Refinement, knowledge: Knowledge) -> list[str]:
    notes = []
    for i, (cells, noise) in enumerate(zip(refinement.captures, refinement.noise, strict=True)):
        of = f"{knowledge.words.taken.capitalize()} {i + 1}: " if len(refinement.captures) > 1 else ""
        if noise.inflation > 1:
            notes.append(
                f"{of}Residuals vary smoothly over a face, {np.sqrt(noise.inflation):.1f} times as much as "
                "independent matches would; the sigmas contain that."
            )
        if cells.rejected > 0.01:
            notes.append(f"{of}{100 * cells.rejected:.1f} % of the matches on the faces were left out as outliers.")
    return notes
