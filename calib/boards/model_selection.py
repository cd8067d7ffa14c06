"""Which terms each lens has, whether pixels are square, and how the board is bent."""

from itertools import product

from calib.boards.likelihood import Prior
from calib.boards.parameters import ASPECT, BEND, CAMERA, LENS, PROJECTOR
from calib.numerics import Floats
from calib.refinement import Terms, most_probable

_K1, _K2, _P1, _P2, _K3 = range(LENS.start, LENS.stop)
_RADIAL = ((_K1, _K2, _K3), (_K2, _K3), (_K3,), ())  # left out, with 0, 1, 2, 3 radial terms
_OF_DEVICE = tuple(
    (*radial, *tangential, *aspect)
    for radial in _RADIAL
    for tangential in ((_P1, _P2), ())
    for aspect in ((ASPECT,), ())
)
_OF_BEND = (tuple(range(7)), (3, 4, 5, 6), ())


_CHOICES = [
    (
        *(CAMERA.start + column for column in camera),
        *(PROJECTOR.start + column for column in projector),
        *(BEND.start + column for column in bend),
    )
    for camera, projector, bend in product(_OF_DEVICE, _OF_DEVICE, _OF_BEND)
]


def choose_terms(values: Floats, covariance: Floats, prior: Prior) -> Terms:
    """The most probable choice, all being equally likely beforehand.

    `values` (SHARED,), `covariance` (SHARED, SHARED): with all terms free.
    """
    return most_probable(values, covariance, prior.sigma, _CHOICES)
