"""How far the projector's picture is shifted from station to station, as by a rig that warms up.

Found by what shifts of all stations would gain beyond chance, as of a random effect (DerSimonian and Laird,
"Meta-analysis in clinical trials", 1986). What they would gain by chance is told by the scores of places: errors of
points nearby are alike (Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986).
"""

from dataclasses import replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats, clustered_scatter, inverse_of
from calib.scene.problem import SceneProblem
from calib.scene.rigid_scene import RigidScene

DRIFTED = FindingKind(
    "picture-drifts",
    "The projector's picture is shifted from one capture of a calibration to the next. The shifts were estimated with "
    "the rig, which does not suffer much; the clouds of single captures keep them.",
    "Let the projector and the camera warm up for half an hour, and see that nothing touches them.",
    data=("drift_px",),
)
_TOLD_PX = 0.1
_LEAST_SHARE = 1e-4  # of the best determined shift, of one that is undetermined


def measure_drift(problem: SceneProblem, scene: RigidScene) -> float:
    """Standard deviation of the shifts of projector pictures near an adjusted scene, in pixels; 0 if they may be
    chance.
    """
    scene, problem = scene.with_shifts(), replace(problem, spread=replace(problem.spread, drift_px=np.inf))
    assert scene.shift_px is not None
    fit = problem.evaluate(scene)
    shifts = scene.columns.of_shifts.ravel()
    remaining = np.setdiff1d(scene.columns.free(problem.prior), shifts)
    following = inverse_of(fit.information[np.ix_(remaining, remaining)]) @ fit.information[np.ix_(remaining, shifts)]
    shift_information = fit.information[np.ix_(shifts, shifts)] - fit.information[np.ix_(shifts, remaining)] @ following
    own = np.zeros((scene.size, len(shifts)))
    own[shifts], own[remaining] = np.eye(len(shifts)), -following
    pull = shift_information @ scene.shift_px.ravel() - fit.gradient @ own
    inverse = np.linalg.pinv(shift_information, rcond=_LEAST_SHARE, hermitian=True)
    gain = float(pull @ inverse @ pull)
    by_chance = float(np.trace(inverse @ _scatter(problem, scene, own)))
    return float(np.sqrt(max(gain - by_chance, 0.0) / max(float(np.trace(shift_information)), 1e-300)))


def drift_findings(drift_px: float) -> tuple[Finding, ...]:
    """A warning if the projector's picture was shifted by more than clouds should keep; () otherwise."""
    if drift_px < _TOLD_PX:
        return ()
    message = f"The projector's picture is shifted from capture to capture, by {drift_px:.2g} px in x and in y (rms)."
    return (Finding(DRIFTED, Severity.WARNING, message, DRIFTED.remedy, {"drift_px": drift_px}),)


def _scatter(problem: SceneProblem, scene: RigidScene, own: Floats) -> Floats:
    """The scatter (K, K) of the gradient along directions `own` (size, K) of the columns."""
    scores = problem.residuals(scene).scores(problem.observations) @ own
    by_match = problem.scores_of_matches(scene) @ own
    return clustered_scatter(scores, scene.places) + by_match.T @ by_match
