"""Networks: captures of several cameras and projectors → every device, one cloud, and whether the cameras agree."""

from scanner.networks.captures import Captures, Pair
from scanner.networks.graph import network_graph
from scanner.networks.job import scan_network
from scanner.networks.scenes import calibrate_by_scene
from scanner.networks.sights import OnSight, PairProgress, Watched, frames_in, in_light
from scanner.networks.solve import KnownDistance
from scanner.networks.verdict import verdict_on
