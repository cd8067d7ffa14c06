"""The paper's closed forms: intrinsics carried through the corner from one device to the other, and its objective."""

from calib.closed_form.transfer import (
    Transfer,
    decompose,
    image_of_corner,
    intrinsic_matrices,
    resected,
    share_in_front,
)
from calib.closed_form.transfer_objective import Objective, exact_search, objective_for, search
