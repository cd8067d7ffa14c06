"""Whole commands, on nearly correct input."""

from dataclasses import replace
from pathlib import Path
from shutil import rmtree

import numpy as np
import yaml

from tests.fuzz.guarded import Run, guarded
from tests.fuzz.mutations import Random, of_csv, of_header, of_yaml

_VIEWS = 3
_BOARDS = ("chessboard:7x5", "chessboard:5x7", "chessboard:4x4", "charuco:6x9", "aprilgrid:6x6", "circles:7x5", "x:1x1")
_SQUARES = ("50mm", "50mm", "1e-300mm", "1e300mm", "1e-6", "1000km", "0", "nan", "5 in", "\x1b[31m", "9" * 400)


def board(folder: Path) -> Run:
    """`scan board`: boards at unusual poses, damaged frames and listings, and other boards than stated."""
    from calib.synthetic import BoardOptions, random_boards
    from scanner.commands import NAMED, parser_of
    from scanner.io import read_calibration
    from scanner.targets import parse_target
    from tests.support.board_captures import CAMERA, PROJECTOR, write_board_capture

    options = BoardOptions(CAMERA, PROJECTOR, 7, 5, 0.05, _VIEWS, distance=(0.9, 1.3), matches=1, bend=0.0)
    made = random_boards(np.random.default_rng(1), options)
    target, captures, out = parse_target(_BOARDS[0], options.square), folder / "captures", folder / "out"
    for number, pose in enumerate(made.poses):
        write_board_capture(captures / f"{number}", target, made.calibration, pose)
    odd, parser, command = captures / "odd", parser_of("board"), NAMED["board"]

    def spoil(rng: Random) -> None:
        if rng.random() < 0.5:
            listing = yaml.safe_load((odd / "capture.yaml").read_text())
            (odd / "capture.yaml").write_bytes(of_yaml(listing, rng))
        for frame in sorted((odd / "frames").iterdir()):
            if rng.random() < 0.05:
                frame.write_bytes(of_header(frame.read_bytes(), rng))

    def read(rng: Random) -> None:
        rmtree(odd, ignore_errors=True)
        tilt_deg = (0.0, 60.0) if rng.random() < 0.5 else (0.0, 0.0)
        distance = (0.6, 3.0) if rng.random() < 0.5 else (1.0, 1.0)
        other = random_boards(rng, replace(options, views=1, tilt_deg=tilt_deg, distance=distance))
        pose = made.poses[0] if rng.random() < 0.2 else other.poses[0]
        write_board_capture(odd, target, made.calibration, pose)
        if rng.random() < 0.6:
            spoil(rng)
        given = [captures / f"{number}" for number in rng.permutation(_VIEWS)[: int(rng.integers(_VIEWS + 1))]]
        named, square = (
            words[int(rng.integers(len(words)))] if rng.random() < 0.3 else words[0] for words in (_BOARDS, _SQUARES)
        )
        arguments = [*map(str, given), str(odd), "--board", named, f"--square={square}", "--out", str(out)]
        command.of(parser.parse_args([*arguments, "--overwrite", "--quiet"])).run()
        read_calibration(out / "calibration.yaml")

    return guarded(read)


def batch(folder: Path) -> Run:
    """`scan batch` with lists of existing and missing captures, and the resulting table."""
    from scanner.batch import BatchRequest, Delivery, list_jobs, run_batch, work
    from scanner.ui import EXIT_INPUT, EXIT_REFUSED, Terminal
    from tests.support.small_capture import write_capture

    for name in ("a", "b"):
        write_capture(folder / name)
    (folder / "room.yaml").write_text("method: paper\n")
    (folder / "known.yaml").write_text("camera: none")
    rows = [
        {"capture": "a", "name": "first", "config": "room.yaml", "calibration": "", "set": "method=refined"},
        {"capture": str(folder / "b"), "name": "", "config": "", "calibration": "known.yaml", "set": ""},
        {"capture": "b", "name": "deep/er", "config": "", "calibration": "", "set": "corner.squareness_deg=1;method=x"},
    ]
    terminal = Terminal(quiet=True)

    def read(rng: Random) -> None:
        path, out = folder / "list.csv", folder / "out"
        path.write_bytes(of_csv(rows[: 1 + int(rng.integers(len(rows)))], rng))
        try:
            jobs = list_jobs([str(path)], BatchRequest())[:3]
            found = [work(job, Delivery(str(out))) for job in jobs]
            assert {row.exit_code for row in found} <= {0, EXIT_INPUT, EXIT_REFUSED}, [row.reason for row in found]
            assert run_batch(jobs, str(out), None, terminal).kept == len(jobs)
        finally:
            rmtree(out, ignore_errors=True)

    return guarded(read)
