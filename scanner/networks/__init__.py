"""Networks: captures of several cameras and projectors → every device, one cloud, and whether the cameras agree."""

from scanner.networks.captures import Captures, Pair
from scanner.networks.job import scan_network
from scanner.networks.sights import OnSight, PairProgress, Watched, frames_in, in_light, network_graph
from scanner.networks.solve import KnownDistance, calibrate_by_scene
from scanner.networks.verdict import verdict_on
