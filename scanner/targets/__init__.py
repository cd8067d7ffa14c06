"""Printed targets: which there are, where their points are, and where these are in a picture."""

from scanner.targets.detection import Detected, NotFoundError, detect, on_board
from scanner.targets.target import CHARUCO_A4, KINDS, TAG_SPACING, UNIT, Target, parse_target
