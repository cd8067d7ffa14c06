"""Detection of a turntable: whether the poses are rotations about one axis. It then reduces their sigmas."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from calib.geometry import Pose, rotation_about, rotation_vector, tangent_basis
from calib.numerics import Floats

_FEWEST = 4  # poses; fewer nearly always share an axis
_ROUNDS = 6
_STEP = 1e-6
_DOUBT, _CALM = 1e-4, 1.5  # the sigmas are estimates themselves
_LEAST_TURN = np.radians(0.3)


@dataclass(frozen=True, eq=False)
class Turntable:
    """`direction` (3,), unit, and a `point` (3,) on the axis, in the common frame; `angles_deg` (n,) of the poses.

    `places` and `covariance` (6 n, 6 n): poses constrained to rotations about it, as of `JointEstimate`; `deviation`:
    squared deviation of the original poses over its expectation.
    """

    direction: Floats
    point: Floats
    angles_deg: Floats
    places: tuple[Pose, ...]
    covariance: Floats
    deviation: float


def find_turntable(places: Sequence[Pose], covariance: Floats, information: Floats, middle: Floats) -> Turntable | None:
    """The turntable of poses, the first of which is the common frame's; None if their covariance excludes a single
    axis.

    `information` weights them; the covariance, which is estimated from few parts of pictures, is not inverted.
    """
    count = len(places)
    vectors = rotation_vector(Pose.stack(places).rotation)
    turning = np.linalg.norm(vectors, axis=1)
    if count < _FEWEST or np.count_nonzero(turning > _LEAST_TURN) < _FEWEST - 1:
        return None
    _, _, axes = np.linalg.svd(vectors)
    direction = axes[0]
    angles = vectors @ direction
    still = [np.eye(3) - place.rotation for place in places]
    basis = tangent_basis(direction)
    point = (
        basis
        @ np.linalg.lstsq(
            np.concatenate(still) @ basis, np.concatenate([place.translation for place in places]), rcond=None
        )[0]
    )
    weight, allowed = information[6:, 6:], covariance[6:, 6:]
    state = np.concatenate([np.zeros(4), angles[1:]])
    off = np.zeros(6 * (count - 1))
    slopes, solver = np.zeros((len(off), len(state))), np.zeros((len(state), len(off)))
    for _ in range(_ROUNDS):
        off = _deviations(state, direction, point, basis, places, middle)
        for k in range(len(state)):
            ahead = state.copy()
            ahead[k] += _STEP
            slopes[:, k] = (_deviations(ahead, direction, point, basis, places, middle) - off) / _STEP
        solver = np.linalg.pinv(slopes.T @ weight @ slopes, rcond=1e-14, hermitian=True) @ slopes.T @ weight
        state = state - solver @ off
    off = _deviations(state, direction, point, basis, places, middle)
    # Satterthwaite: the weighted square of the residuals follows the χ² distribution whose degrees of freedom give its
    # mean and variance.
    remaining = np.eye(len(off)) - slopes @ solver
    expected = weight @ remaining @ allowed @ remaining.T
    mean = float(np.trace(expected))
    freedom = mean**2 / float(np.sum(expected * expected.T))
    deviation = float(off @ weight @ off) / mean
    if deviation > _CALM**2 * float(chdtri(freedom, _DOUBT)) / freedom:
        return None
    whole = np.zeros_like(covariance)
    by_places = slopes @ solver
    whole[6:, 6:] = max(1.0, deviation) * by_places @ allowed @ by_places.T
    turned, moved = _axis(state, direction, point, basis)
    return Turntable(
        turned,
        moved,
        np.degrees(np.concatenate([[0.0], state[4:]])),
        _places(state, direction, point, basis),
        whole,
        deviation,
    )


def _axis(state: Floats, direction: Floats, point: Floats, basis: Floats) -> tuple[Floats, Floats]:
    turned = direction + basis @ state[:2]
    return turned / np.linalg.norm(turned), point + basis @ state[2:4]


def _places(state: Floats, direction: Floats, point: Floats, basis: Floats) -> tuple[Pose, ...]:
    axis, at = _axis(state, direction, point, basis)
    turns = [np.asarray(rotation_about(angle * axis), np.float64) for angle in (0.0, *state[4:].tolist())]
    return tuple(Pose(turn, at - turn @ at) for turn in turns)


def _deviations(
    state: Floats, direction: Floats, point: Floats, basis: Floats, places: Sequence[Pose], middle: Floats
) -> Floats:
    """Turn, and shift of the middle, from the places but the first to those of the state, (6 (n − 1),)."""
    deviations = []
    for place, wanted in zip(places[1:], _places(state, direction, point, basis)[1:], strict=True):
        step = wanted @ place.inverse()
        deviations.append(np.concatenate([rotation_vector(step.rotation), step @ middle - middle]))
    return np.concatenate(deviations)
