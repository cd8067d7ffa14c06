"""Boards: this program, and local homographies with OpenCV's stereoCalibrate, on real and synthetic captures.

python benchmarks/bench_board.py [--real FOLDER] [--sets 50] [--rendered 8]

Real captures (those of github.com/kamino410/procam-calibration, a chessboard of 9 × 7 corners, squares of 75): the
stereo error by their own definition, and each board predicted by the others. Synthetic ones with ground truth: error
over sigma, and the errors of both beside the Cramér–Rao bound. Rendered ones: six boards in front of the simulated rig
of each seed, from the frames on.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from board_peer import Corners, Peer, calibrate, corners_of, local_corners, predicted
from conditions.captures import patterns_of, take
from cramer_rao import bound_of_boards
from scipy.optimize import least_squares

from calib.boards import Board, BoardCalibration, BoardView, calibrate_boards
from calib.estimation import into_cells
from calib.geometry import Calibration, Size
from calib.numerics import Floats
from calib.refusal import RefusalError
from calib.synthetic import SyntheticBoards, random_boards
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.boards import FromBoards, Target, calibrate_board_captures, calibrate_captures, find_board, read_folders
from scanner.capture import CaptureMetadata
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.results import Decoded
from scanner.ui import Terminal

_TARGET = Target("chessboard", 9, 7, 75.0)
_RENDERED, _SQUARE_M = ((612, 512), (427, 240)), 0.06
_RIGS_TARGET = Target("chessboard", 9, 7, 1000 * _SQUARE_M)
_QUIET = Terminal(quiet=True)
_NAMES = ("f_c", "x_c", "y_c", "f_p", "x_p", "y_p")


def real(folder: Path) -> None:
    recordings = read_folders([folder])
    result = calibrate_captures(recordings, _TARGET, Terminal(quiet=True))
    sizes = recordings[0].camera_size, recordings[0].projector_size
    peers = [corners_of(recording.folder, _TARGET.points, (_TARGET.columns, _TARGET.rows)) for recording in recordings]
    peer = calibrate(peers, *sizes)
    ours = [_own_corners(capture.view) for capture in result.captures]
    print(
        f"stereo error by the script's definition, px (its own output: 0.575)\n  done again   {peer.rms[2]:.3f}",
        end="",
    )
    print(f"  (camera {peer.rms[0]:.3f}, projector {peer.rms[1]:.3f})")
    print(f"  ours, flat boards     {stereo_rms(result.calibrated.calibration, ours):.3f}")
    print(f"  ours, its corners     {stereo_rms(result.calibrated.calibration, peers):.3f}")
    print("each board predicted by the others, matches on it, projector px")
    print(f"  {'':14}{'ours':>8}{'promised':>10}{'OpenCV':>8}{'OpenCV, our corners':>21}")
    errors = []
    for i, prediction in enumerate(result.calibrated.predictions):
        rest = [j for j in range(len(peers)) if j != i]
        cells = result.captures[i].view.cells
        row = [prediction.error_px]
        for corners in (peers, ours):
            without = calibrate([corners[j] for j in rest], *sizes)
            row.append(_rms(predicted(without, corners[i], cells.camera_px) - cells.projector_px))
        errors.append(row)
        print(f"  {prediction.name:14}{row[0]:8.3f}{prediction.expected_px:10.3f}{row[1]:8.3f}{row[2]:21.3f}")
    mine, theirs, with_ours = np.sqrt(np.mean(np.square(errors), axis=0))
    print(f"  {'all':14}{mine:8.3f}{'':10}{theirs:8.3f}{with_ours:21.3f}")
    _scatter_of_focals(result, peers, sizes)


def _scatter_of_focals(result: FromBoards, peers: list[Corners], sizes: tuple[Size, Size]) -> None:
    """Scatter of the projector's parameters when one board is left out."""
    moved = np.array([prediction.moved[[9, 11, 12]] for prediction in result.calibrated.predictions])
    whole = calibrate(peers, *sizes).projector[0]
    theirs = []
    for i in range(len(peers)):
        without = calibrate([peers[j] for j in range(len(peers)) if j != i], *sizes).projector[0]
        theirs.append([np.log(without[0, 0] / whole[0, 0]), without[0, 2] - whole[0, 2], without[1, 2] - whole[1, 2]])
    print("largest change of the projector when one board is left out: focal, principal point x, y")
    for name, changes in (("ours", moved), ("OpenCV", np.array(theirs))):
        most = np.abs(changes).max(axis=0)
        print(f"  {name:8}{100 * most[0]:6.2f} % {most[1]:6.1f} px {most[2]:6.1f} px")


def _own_corners(view: BoardView) -> Corners:
    """The view's corners, with projector pixels from the cells of matches around each."""
    side = 1.2 * float(np.sqrt(np.median(np.ptp(view.cells.camera_px, axis=0).prod() / len(view.cells))))
    return local_corners(view.points, view.corners_px, view.cells.camera_px, view.cells.projector_px, 1.5 * side)


def stereo_rms(calibration: Calibration, boards: list[Corners]) -> float:
    """The stereo error by OpenCV's definition: flat boards, each at its best-fitting pose."""
    camera, projector = calibration.camera, calibration.projector
    squares, count = 0.0, 0
    for board in boards:
        flat = np.concatenate([board.points, np.zeros((len(board.points), 1))], axis=1)

        def residuals(pose: Floats, flat: Floats = flat, board: Corners = board) -> Floats:
            seen = flat @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
            there = calibration.pose @ seen
            both = camera.project(seen) - board.camera_px, projector.project(there) - board.projector_px
            return np.concatenate(both).ravel()

        _, turn, place = cv2.solvePnP(flat, board.camera_px, camera.matrix, np.array(camera.distortion))
        best = least_squares(residuals, np.concatenate([turn.ravel(), place.ravel()]))
        squares += float(np.sum(best.fun**2))
        count += 2 * len(board.points)
    return float(np.sqrt(squares / count))


def _rms(residual: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def views_of(boards: SyntheticBoards) -> list[BoardView]:
    label = [np.zeros(len(view.matches), np.int32) for view in boards.views]
    cells = [into_cells(view.matches.with_faces(face), (0,)) for view, face in zip(boards.views, label, strict=True)]
    both = zip(boards.views, cells, strict=True)
    return [BoardView(f"view {i}", view.points, view.corners_px, each) for i, (view, each) in enumerate(both)]


def errors_of(found: BoardCalibration, truth: Calibration) -> tuple[Floats, Floats]:
    """Errors and sigmas (6,) of `_NAMES`, in px."""
    calibration, sigma = found.calibration, found.calibration.sigma
    error, sigmas = [], []
    for device, true, own in (
        (calibration.camera, truth.camera, sigma.camera),
        (calibration.projector, truth.projector, sigma.projector),
    ):
        error += [
            device.focal_px[0] - true.focal_px[0],
            *np.subtract(device.principal_point_px, true.principal_point_px),
        ]
        sigmas += [own.focal_px[0], *own.principal_point_px]
    return np.array(error), np.array(sigmas)


def _peer_errors(boards: SyntheticBoards) -> Floats:
    corners = []
    for view in boards.views:
        spacing = float(np.median(np.linalg.norm(np.diff(view.corners_px, axis=0), axis=1)))
        matches = view.matches
        corners.append(
            local_corners(view.points, view.corners_px, matches.camera_px, matches.projector_px, 0.5 * spacing)
        )
    truth = boards.calibration
    peer: Peer = calibrate(corners, truth.camera.size, truth.projector.size)
    error = []
    for (matrix, _), device in ((peer.camera, truth.camera), (peer.projector, truth.projector)):
        error += [matrix[0, 0] - device.focal_px[0], *np.subtract(matrix[:2, 2], device.principal_point_px)]
    return np.array(error)


def made_up(sets: int, bend: float) -> None:
    rows = []
    for seed in range(sets):
        boards = random_boards(np.random.default_rng(seed), bend=bend)
        try:
            views = views_of(boards)
            truth = boards.calibration
            found = calibrate_boards(views, truth.camera.size, truth.projector.size, Board(boards.reach, 2, "m"))
        except RefusalError as refusal:
            print(f"set {seed} refused: {refusal}")
            continue
        rows.append([*errors_of(found, truth), _peer_errors(boards), bound_of_boards(boards, views)])
    error, sigma, theirs, bound = np.array(rows).transpose(1, 0, 2)

    print(
        f"{len(rows)} of {sets} made-up sets of six boards, bent by {bend:g} of half their length (1 sigma, each term)"
    )
    print(f"  {'':34}" + "".join(f"{name:>8}" for name in _NAMES))
    for name, values in (
        ("error / sigma, rms", _root(error / sigma)),
        ("error, rms, px", _root(error)),
        ("sigma told, rms, px", _root(sigma)),
        ("Cramér–Rao bound, rms, px", _root(bound)),
        ("OpenCV's error, rms, px", _root(theirs)),
        ("sigma told over OpenCV's error", _root(sigma) / _root(theirs)),
    ):
        print(f"  {name:34}" + "".join(f"{value:8.3f}" for value in values))
    print(f"  error / sigma, rms over all: {float(np.sqrt(np.mean((error / sigma) ** 2))):.3f}")


def _root(values: Floats) -> Floats:
    rms: Floats = np.sqrt(np.mean(values**2, axis=0))
    return rms


def rendered(seeds: int) -> None:
    rows = []
    for seed in range(seeds):
        room = SimulatedRoom(SimulatedRigSettings(seed=seed, interreflection=False, furniture=False), *_RENDERED)
        looked = []
        for pose in range(6):
            posed = room.under(board={"square_m": _SQUARE_M, "pose": pose})
            capture = take(posed, patterns_of("standard", posed_size := _RENDERED[1]), 1.0)
            decoder = Decoder(capture.patterns, posed_size)
            for frame in capture.frames:
                decoder.add(frame)
            decoding = decoder.finish()
            metadata = CaptureMetadata(Size(*_RENDERED[0]), Size(*posed_size))
            looked.append(
                find_board(Decoded(metadata, decoding.matches, decoding, f"pose {pose}"), _RIGS_TARGET, _QUIET)
            )
        try:
            result = calibrate_board_captures(looked, _RIGS_TARGET, Size(*_RENDERED[0]), Size(*_RENDERED[1]), _QUIET)
        except (RefusalError, InputError) as refusal:
            print(f"seed {seed}: {refusal}")
            continue
        error, sigma = errors_of(result.calibrated, room.calibration)
        rows.append((error, sigma))
        print(
            f"  seed {seed}: " + "".join(f"{e:+8.3f} ± {s:.3f}" for e, s in zip(error, sigma, strict=True)), flush=True
        )
    error, sigma = np.array(rows).transpose(1, 0, 2)
    print(f"{len(rows)} of {seeds} rendered sets of six boards: error / sigma, rms")
    print("".join(f"  {name} {value:.2f}" for name, value in zip(_NAMES, _root(error / sigma), strict=True)))
    print(f"  over all {float(np.sqrt(np.mean((error / sigma) ** 2))):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, help="folder with the captures")
    parser.add_argument("--sets", type=int, default=50)
    parser.add_argument("--rendered", type=int, default=0, help="number of sets of frames by the simulated rig")
    arguments = parser.parse_args()
    if arguments.real:
        real(arguments.real)
    for bend in (0.0, 0.002) if arguments.sets else ():
        made_up(arguments.sets, bend)
    if arguments.rendered:
        rendered(arguments.rendered)


if __name__ == "__main__":
    main()
