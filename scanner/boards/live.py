"""Calibrate a live rig from boards: after each capture, the operator sees its contribution and moves the board."""

from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np

from calib.boards import FEWEST_VIEWS, best_next_pose
from calib.refusal import RefusalError
from hw.backends import RigSettings
from hw.settings import SimulatedRigSettings
from scanner.acquisition import take
from scanner.boards.calibrate import BoardCapture, FromBoards, Missing, calibrate_board_captures, find_board
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.reconstruction import lenses_of
from scanner.results import CAPTURES_FOLDER
from scanner.targets import Target
from scanner.ui import Terminal

_WORTH_IT = 1.05  # least factor on the sigmas


def check_live(config: Config, number: int, target: Target, terminal: Terminal) -> None:
    """Raise InputError if no capture could lead to a calibration."""
    if number < FEWEST_VIEWS:
        raise InputError(f"--captures {number}: expected {FEWEST_VIEWS} or more of a board, six to ten are good")
    lenses_of(config, config.camera_size, config.projector_size)
    rig = config.required_rig
    if not isinstance(rig, SimulatedRigSettings):
        if not terminal.can_ask:
            raise InputError(
                f"--captures {number} asks you to move the board between captures, but the input is no terminal: run "
                "it in one, or capture with scan and give the recordings to scan board"
            )
    elif not rig.board.square_m or f"{rig.board.kind}:{rig.board.columns}x{rig.board.rows}" != str(target):
        raise InputError(
            f"the simulated rig holds no board like {target}: it has chessboards and ChArUco boards, as with "
            "--set rig.board.square_m=0.06 --board chessboard:9x7"
        )


def capture_boards(config: Config, number: int, target: Target, folder: Path, terminal: Terminal) -> FromBoards:
    """Capture this many views with the board, each recorded in `folder`, and calibrate from all.

    Raises DeviceError, RefusalError, and InputError if the operator ends too early.
    """
    looked: list[BoardCapture | Missing] = []
    for step, rig in _rigs(config.required_rig):
        views = sum(isinstance(look, BoardCapture) for look in looked)
        if views == number or (step and not _moved(looked, views, number, rig, terminal)):
            break
        place = folder / CAPTURES_FOLDER / str(step + 1)
        place.mkdir(parents=True)
        looked.append(find_board(take(rig, config, place, terminal, f"capture {step + 1}"), target, terminal))
        _tell(looked, config, target, terminal)
    return calibrate_board_captures(looked, target, config.camera_size, config.projector_size, terminal, config)


def _rigs(settings: RigSettings) -> Iterator[tuple[int, RigSettings]]:
    for step in count():
        if isinstance(settings, SimulatedRigSettings):
            board = settings.board.model_copy(update={"pose": settings.board.pose + step})
            yield step, settings.model_copy(update={"board": board})
        else:
            yield step, settings


def _moved(looked: list[BoardCapture | Missing], views: int, number: int, rig: RigSettings, terminal: Terminal) -> bool:
    """Whether the board was moved, and not the operator has had enough."""
    if isinstance(rig, SimulatedRigSettings):
        # A simulated board moves by itself: if it is never found, continuing does not help.
        return len(looked) < 2 * number
    question = (
        f"{views} of {number} captures. Move the board, and nothing else; then press Enter, or q and Enter to end: "
    )
    return not terminal.ask(question).strip().lower().startswith("q")


def _tell(looked: list[BoardCapture | Missing], config: Config, target: Target, terminal: Terminal) -> None:
    """Show the contribution of the last capture, and how to hold the board next."""
    last = looked[-1]
    if isinstance(last, Missing):
        terminal.show(f"{last.name} does not count: {last.why}.")
        return
    count = sum(isinstance(look, BoardCapture) for look in looked)
    if count < FEWEST_VIEWS:
        terminal.show(f"{last.name}: the board was found. {FEWEST_VIEWS - count} more needed for a first estimate.")
        return
    try:
        result = calibrate_board_captures(looked, target, config.camera_size, config.projector_size, terminal, config)
    except RefusalError as refusal:
        terminal.show(f"{last.name}: the board was found. Not yet enough: {refusal.reason} {refusal.advice}")
        return
    estimate, sizes = result.calibrated.estimate, result.calibrated.calibration.sizes
    sigma = 100 * np.sqrt(estimate.covariance.diagonal())
    message = f"{last.name}: focal lengths are now known to {sigma[0]:.2g} % (camera) and {sigma[9]:.2g} % (projector)."
    pose = best_next_pose(estimate, sizes)
    if pose is not None and pose.gain > _WORTH_IT:
        message += f" Most useful next: a board {pose.words}, which lowers the sigmas by a factor of {pose.gain:.2f}."
    elif pose is not None:
        message += " No further board would add much."
    terminal.show(message)
