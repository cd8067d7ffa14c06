"""How far the projector's picture is shifted from station to station, as by a rig that warms up.

Found by what shifts of all stations would gain beyond chance, as of a random effect (DerSimonian and Laird,
"Meta-analysis in clinical trials", 1986). What they would gain by chance is told by the scores of places: errors of
points nearby are alike (Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986).
"""

from dataclasses import replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats, clustered_scatter, huber_weights
from calib.refinement import Prior, inverse_of
from calib.scene.bundle import SceneFit, evaluate
from calib.scene.residuals import HUBER_SIGMAS, missed_at_stations, residuals_of
from calib.scene.rigid_scene import ErrorScales, RigidScene, SceneObservations, StationMatches

DRIFTED = FindingKind(
    "picture-drifts",
    "The projector's picture is shifted from one capture of a calibration to the next. The shifts were estimated with "
    "the rig, which does not suffer much; the clouds of single captures keep them.",
    "Let the projector and the camera warm up for half an hour, and see that nothing touches them.",
    data=("drift_px",),
)
_TOLD_PX = 0.1
_LEAST_SHARE = 1e-4  # of the best determined shift, of one that is undetermined


def measure_drift(
    scene: RigidScene, observations: SceneObservations, matches: StationMatches, spread: ErrorScales, prior: Prior
) -> float:
    """Standard deviation of the shifts of projector pictures near an adjusted scene, in pixels; 0 if they may be
    chance.
    """
    scene, spread = scene.with_shifts(), replace(spread, drift_px=np.inf)
    assert scene.shift_px is not None
    fit = evaluate(scene, observations, matches, spread, prior)
    shifts = scene.columns.of_shifts.ravel()
    others = np.setdiff1d(scene.columns.free(prior), shifts)
    following = inverse_of(fit.information[np.ix_(others, others)]) @ fit.information[np.ix_(others, shifts)]
    left = fit.information[np.ix_(shifts, shifts)] - fit.information[np.ix_(shifts, others)] @ following
    own = np.zeros((scene.size, len(shifts)))
    own[shifts], own[others] = np.eye(len(shifts)), -following
    pull = left @ scene.shift_px.ravel() - fit.gradient @ own
    inverse = np.linalg.pinv(left, rcond=_LEAST_SHARE, hermitian=True)
    gain = float(pull @ inverse @ pull)
    by_chance = float(np.trace(inverse @ _scatter(fit, own, observations, matches, spread)))
    return float(np.sqrt(max(gain - by_chance, 0.0) / max(float(np.trace(left)), 1e-300)))


def drift_findings(drift_px: float) -> tuple[Finding, ...]:
    """A warning if the projector's picture was shifted by more than clouds should keep; () otherwise."""
    if drift_px < _TOLD_PX:
        return ()
    message = f"The projector's picture is shifted from capture to capture, by {drift_px:.2g} px in x and in y (rms)."
    return (Finding(DRIFTED, Severity.WARNING, message, DRIFTED.remedy, {"drift_px": drift_px}),)


def _scatter(
    fit: SceneFit, own: Floats, observations: SceneObservations, matches: StationMatches, spread: ErrorScales
) -> Floats:
    """The scatter (K, K) of the gradient along directions `own` (size, K) of the columns."""
    scores = residuals_of(fit.scene, observations, spread).scores(observations) @ own
    miss, by_columns = missed_at_stations(fit.scene, matches, spread)
    by_match = (by_columns @ own) * (huber_weights(np.abs(miss), HUBER_SIGMAS) * miss)[:, None]
    return clustered_scatter(scores, fit.scene.places) + by_match.T @ by_match
