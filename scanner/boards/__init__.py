"""Calibration from captures of a printed board: kinds of boards, their detection, the result and its page."""

from scanner.boards.calibrate import FromBoards, calibrate_captures
from scanner.boards.document import read_folders
from scanner.boards.live import capture_boards, check_live
from scanner.boards.result import save_result, summary
from scanner.boards.verdict import verdict_on
from scanner.targets.target import KINDS, Target, parse_target
