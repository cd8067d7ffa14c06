"""Networks: several cameras and projectors in one room, calibrated together by the walls that they light and see."""

from calib.networks.diagnostics import Strain
from calib.networks.estimate import NetworkEstimate, estimate_network
from calib.networks.from_pairs import estimate_from_pairs
from calib.networks.joined import DepthDisagreement, Joined, joined
from calib.networks.network import PER_NODE, PLACE, Device, Network, meeting_points, point_slopes
from calib.networks.observations import PlaneObservation
from calib.networks.warps import Warp, Warps
