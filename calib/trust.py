"""Whether a refined solution deserves to be used; what does not is refused with its reason."""

from collections.abc import Sequence

import numpy as np

from calib.arrays import Floats
from calib.cells import Cells
from calib.degeneracy import reasons_in_images, reasons_in_space
from calib.likelihood import Fit, Knowledge
from calib.model import CAMERA, PROJECTOR
from calib.refine import Refinement
from calib.refusal import RefusalError

MOVE = "Move the rig so that all three faces are seen large and at different slants by both devices, and scan again."

_USEFUL_SIGMA = 0.2  # of a focal length
_CLEARLY_WORSE = 9.0  # in cost, that is three sigmas
_TENSION_SIGMAS = 4.0
_PLAUSIBLE_FOCAL = (0.2, 10.0)  # in projector widths


def no_corner(captures: Sequence[Cells]) -> RefusalError:
    """The refusal where no focal length makes a corner of the faces."""
    return RefusalError(
        "These three faces are not the picture of a square corner for any focal length of the camera"
        + _because([reason for cells in captures for reason in reasons_in_images(cells)]),
        "A face may be wrong, or pass through one of the devices. " + MOVE,
    )


def refuse_untrustworthy(refinement: Refinement, knowledge: Knowledge) -> None:
    """Raise RefusalError where the solution is not determined, not the only one, or not of a square corner."""
    fit = refinement.fit
    sigma = np.sqrt(np.diag(refinement.covariance))
    relative = {"camera": float(sigma[CAMERA.start]), "projector": float(sigma[PROJECTOR.start])}
    for device, value in relative.items():
        if not value < _USEFUL_SIGMA:
            raise RefusalError(
                f"This view hardly determines the {device}'s focal length: its sigma is {100 * value:.0f} %"
                + _because(_reasons(refinement)),
                MOVE + " A principal point that is known, or a corner that is known to be square, also helps.",
            )
    _refuse_ambiguous(fit, refinement.others, relative["camera"])
    field = float(fit.state.projector[0]) / knowledge.projector_size[0]
    if not _PLAUSIBLE_FOCAL[0] < field < _PLAUSIBLE_FOCAL[1]:
        raise RefusalError(
            f"The solution has a projector whose focal length is {field:.2g} times its width, which no projector has"
            + _because(_reasons(refinement)),
            "The faces may not be square to each other, or frames and patterns do not belong together. " + MOVE,
        )
    for off in np.degrees(fit.state.off_square):
        if np.linalg.norm(off) > _TENSION_SIGMAS * knowledge.squareness_deg > 0:
            raise RefusalError(
                f"The faces are not square to each other: they seem to be off by {signed(off)} degrees, where "
                f"{knowledge.squareness_deg:g} was expected.",
                "Choose another corner, or give a larger corner.squareness_deg.",
            )


def signed(values: Floats) -> str:
    """Numbers with their signs, for a sentence."""
    return ", ".join(f"{value:+.2f}" for value in values)


def _refuse_ambiguous(best: Fit, others: Sequence[Fit], relative_sigma: float) -> None:
    for other in others:
        apart = abs(np.log(other.state.camera[0] / best.state.camera[0]))
        if other.cost - best.cost < _CLEARLY_WORSE and apart > 2 * relative_sigma:
            raise RefusalError(
                f"Ambiguous: a camera focal length of {best.state.camera[0]:.0f} px and one of "
                f"{other.state.camera[0]:.0f} px explain this capture almost equally well.",
                "Capture the same corner again from another place with the rig unchanged.",
            )


def _reasons(refinement: Refinement) -> list[str]:
    reasons = []
    for i, cells in enumerate(refinement.captures):
        reasons += reasons_in_images(cells) or reasons_in_space(refinement.fit.state, i)
    return reasons


def _because(reasons: list[str]) -> str:
    unique = list(dict.fromkeys(reasons))
    return f": {'; '.join(unique)}." if unique else "."
