"""Maximum-likelihood estimation: cells of matches, the model and its Jacobian, focal sweep, profile, lens terms."""

from calib.refinement.alternatives import alternative, averaged
from calib.refinement.distortion_from_planes import Straightened, straighten
from calib.refinement.focal_sweep import Family, at_focal, family_of, minima, photo_family, sweep_one, twins
from calib.refinement.further_planes import depths, with_further_planes
from calib.refinement.likelihood import (
    SQUARENESS_DEG,
    SQUARENESSES_DEG,
    CornerFit,
    CornerProblem,
    Knowledge,
    Prior,
    of_any_device,
)
from calib.refinement.parameters import (
    CAMERA,
    PER_CORNER,
    PER_DEVICE,
    PROJECTOR,
    ROTATION,
    SHARED,
    TANGENTIAL,
    TANGENTIAL_TERMS,
    TRANSLATION,
    WEAK_TERMS,
    FurtherPlane,
    PlacedCorner,
    State,
    device_of,
    intrinsic_distance,
    moved_device,
    predict,
    without_lens,
)
from calib.refinement.priors import (
    DECENTERINGS,
    ORDINARY_LENSES,
    RADIAL,
    THIRD_RADIAL,
    KnownRig,
    LensPrior,
    PrincipalPoint,
)
from calib.refinement.refine import CLEARLY_WORSE, Refinement, explore, refine, settle, thin
from calib.refinement.shared_corner import is_anticlockwise, oriented, reflected
from calib.refinement.systematic_shifts import (
    covariance_of_smooth_errors,
    percent_of_intrinsics,
    response_to_shift,
    together,
)
