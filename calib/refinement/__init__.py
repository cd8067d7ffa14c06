"""Maximum-likelihood estimation: cells of matches, the model and its Jacobian, focal sweep, profile, lens terms."""

from calib.refinement.alternatives import PictureScale, alternative
from calib.refinement.distortion_from_planes import Straightened, straighten
from calib.refinement.focal_sweep import at_focal, family_of, minima, photo_family, sweep_one, twins
from calib.refinement.further_planes import depths, with_further_planes
from calib.refinement.likelihood import (
    ROBUST_SIGMAS,
    SQUARENESS_DEG,
    SQUARENESSES_DEG,
    Fit,
    Knowledge,
    Prior,
    evaluate,
    misfit,
    of_any_device,
)
from calib.refinement.match_cells import Cells, follow_one_plane, into_cells, joined
from calib.refinement.noise_model import Noise, long_waves, noise_of, overdispersion
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
    ColumnPrior,
    KnownRig,
    LensPrior,
    PrincipalPoint,
)
from calib.refinement.profile_likelihood import covariance_of, inverse_of
from calib.refinement.refine import CLEARLY_WORSE, Refinement, explore, refine, settle, thin
from calib.refinement.shared_corner import is_anticlockwise, oriented, reflected
from calib.refinement.systematic_shifts import (
    Shift,
    Shifts,
    covariance_of_smooth_errors,
    percent_of_intrinsics,
    response_to_shift,
    together,
)
