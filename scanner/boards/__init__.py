"""Calibration from captures of a printed board: kinds of boards, their detection, the result and its page."""

from scanner.boards.calibrate import (
    FromBoards,
    calibrate_board_captures,
    calibrate_captures,
    find_board,
    read_folders,
)
from scanner.boards.live import capture_boards, check_live
from scanner.boards.printing import draw_target, printed_target, write_pdf
from scanner.boards.result import save_result, summary, verdict_on
from scanner.targets import KINDS, Target, parse_target
