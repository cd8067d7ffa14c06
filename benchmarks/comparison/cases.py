"""The commands that are compared, as they are typed after `scan` in a folder of their own.

That folder has links: `configs` to the checkout's own configurations; `old` to the results of the first checkout, one
folder for each case, so that both checkouts work on the same files; `inputs` to what `inputs.py` makes.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """A command, and the `exit_code` with which it should end, so that it does not fail unnoticed in both checkouts."""

    command: str
    exit_code: int = 0


def _set(**values: object) -> str:
    """Words that set keys of a configuration, with __ for the dots between them."""
    return " ".join(f"--set '{key.replace('__', '.')}={value}'" for key, value in values.items())


def _sizes(camera: tuple[int, int], projector: tuple[int, int]) -> str:
    sizes = (f"{{width: {width}, height: {height}}}" for width, height in (camera, projector))
    return _set(**dict(zip(("camera", "projector"), sizes, strict=True)))


_QUICK = _set(sequence__preset="quick")
_SMALL = f"{_sizes((306, 256), (427, 240))} {_QUICK}"
_EMPTY = _set(rig__furniture="false", rig__interreflection="false")
_CORNER = f"--out out --config configs/room-sim.yaml {_SMALL}"
_SQUARE = _set(rig__walls_off_deg=0, corner__squareness_deg=0, camera__principal_point="{known: [157.04, 131.79]}")
_HALL = f"--config configs/hall-sim.yaml {_sizes((240, 200), (214, 120))}"
_ROOM = f"--config configs/room-whole-sim.yaml {_SMALL}"
_THING = f"--config configs/thing-sim.yaml {_SMALL}"
_THING_RIG = "--calibration old/scan-refused/out/truth.yaml"
# Without noise, all rounds of one view are alike: which of them becomes a cloud depends on the computer's speed.
_NO_NOISE = _set(rig__full_well_electrons="1e18", rig__read_noise_electrons=0)
_FILM = (
    f"--config configs/room-sim.yaml {_sizes((384, 216), (256, 144))} {_QUICK} {_EMPTY} "
    f"{_set(rig__walls_off_deg=0, corner__squareness_deg=0, camera__principal_point='{known: [197.07, 165.38]}')}"
)
_SHEET = _set(
    rig__board="{kind: charuco, columns: 5, rows: 4, square_m: 0.09, on_floor: true}",
    scale="{charuco: {board: 5x4, square_mm: 90}}",
)
_BOARD = "--out out --board chessboard:9x7 --square 60mm"
_BOARD_RIG = f"--config configs/room-sim.yaml {_sizes((408, 342), (427, 240))} {_QUICK} {_EMPTY}"


def _captures(case: str, *numbers: int) -> str:
    return " ".join(f"old/{case}/out/captures/{number}" for number in numbers)


def _boards(*numbers: int) -> str:
    return " ".join(f"old/board/out/captures/{number}/capture" for number in numbers)


def _pairs(*names: str) -> str:
    return " ".join(f"old/network/out/captures/{name}" for name in names)


_SCANS = {
    "scan": Case(_CORNER),
    "scan-square": Case(f"{_CORNER} {_SQUARE}"),
    "scan-paper": Case(f"{_CORNER} {_SQUARE} --set method=paper"),
    "scan-twice": Case(f"{_CORNER} --captures 2 {_set(rig__seed=1)}"),
    "scan-standard": Case(f"{_CORNER} {_SQUARE} {_set(sequence__preset='standard', rig__seed=2)}"),
    "scan-concave": Case(f"{_CORNER} {_SQUARE} {_set(sequence__preset='concave', rig__seed=3)}"),
    "scan-exposures": Case(f"{_CORNER} {_SQUARE} {_set(sequence__exposures_us='[4000, 16000]')}"),
    "scan-photographed": Case(f"{_CORNER} {_SQUARE} {_set(rig__camera_response='photo', rig__bit_depth=16)}"),
    "scan-bumped": Case(f"{_CORNER} {_SQUARE} {_set(rig__bump='{device: camera, frame: 14, px: 0.5}')}"),
    "scan-drifting": Case(f"{_CORNER} {_SQUARE} {_set(rig__drift='{device: projector, px_per_frame: 0.02}')}"),
    "scan-light-switched": Case(f"{_CORNER} {_SQUARE} {_set(rig__light='{frame: 9, ambient: 0.4}')}"),
    "scan-passer": Case(f"{_CORNER} {_SQUARE} {_set(rig__passer='{width_m: 0.4, first_frame: 5, last_frame: 12}')}", 2),
    "scan-passer-left-out": Case(
        f"{_CORNER} {_SQUARE} {_set(rig__passer='{width_m: 0.1, first_frame: 10, last_frame: 11}')}"
    ),
    "scan-pushed": Case(f"{_CORNER} {_SQUARE} {_set(rig__pushed='{width_m: 0.4, frame: 10, by_m: 0.2}')}"),
    "scan-flickering": Case(
        f"{_CORNER} {_SQUARE} {_set(rig__ghost=0.1, rig__flicker=0.05, rig__rolling_shutter_ms=10)}"
    ),
    "scan-keystone": Case(f"{_CORNER} {_SQUARE} {_set(rig__panel='{keystone: 0.02}')}"),
    "scan-balls": Case(f"{_CORNER} {_SQUARE} {_set(rig__ball_bar_m=0.5, scale__baseline_m=0.5)}"),
    "scan-board-rig": Case(f"--out out {_BOARD_RIG}"),
    "scan-sheet": Case(
        f"--out out --config configs/room-sim.yaml {_sizes((918, 768), (427, 240))} {_QUICK} {_EMPTY} {_SHEET} "
        f"{_set(rig__seed=2, rig__walls_off_deg=0, corner__squareness_deg=0)}"
    ),
    "scan-refused": Case(f"--out out {_THING}", 4),
    "scan-mirrored": Case(f"{_CORNER} {_set(rig__panel='{mirrored: true}')}", 2),
    "scan-unknown-key": Case(f"{_CORNER} {_set(rig__sead=3)}", 2),
    "scan-no-device": Case("--out out --config configs/room-webcam.yaml", 3),
}
_RECORDINGS = {
    "replay": Case("replay --out out old/scan-square/out/capture"),
    "replay-calibrated": Case(
        "replay --out out old/scan-square/out/capture --calibration old/scan-square/out/truth.yaml"
    ),
    "replay-masks": Case("replay --out out old/scan-square/out/capture --masks inputs/masks"),
    "replay-one-axis": Case("replay --out out inputs/one-axis --calibration old/scan-square/out/truth.yaml"),
    "replay-swapped": Case("replay --out out inputs/swapped", 2),
    "replay-stopped": Case("replay --out out inputs/stopped"),
    "replay-damaged": Case("replay --out out inputs/damaged", 2),
    "calibrate": Case(f"calibrate old/scan-twice/out {_CORNER}"),
    "calibrate-refused": Case(f"calibrate old/scan-square/out old/scan-twice/out {_CORNER}", 4),
    "batch": Case("batch inputs/captures --out out --workers 1"),
}
_SEVERAL = {
    "room": Case(f"--out out {_ROOM} --stations 3"),
    "room-calibrated": Case(
        f"room --out out {_ROOM} {_captures('room', 3, 1, 2)} old/scan/out --calibration old/room/out/truth.yaml"
    ),
    "room-refused": Case(f"room --out out {_ROOM} {_captures('room', 1)} old/scan/out", 4),
    "object": Case(f"--out out {_THING} --object --stations 4 {_THING_RIG}"),
    "object-filled": Case(f"object --out out {_THING} --fill {_captures('object', 4, 2, 1)} {_THING_RIG}"),
    "object-refused": Case(f"object --out out {_THING} inputs/unturned/1 inputs/unturned/2 {_THING_RIG}", 4),
    "object-ambiguous": Case(
        f"--out out {_THING} --object --stations 3 {_THING_RIG} "
        f"{_set(rig__thing='{kind: ball, steps: 12, patches: 0}')}",
        4,
    ),
    "network": Case(f"network --out out {_HALL}"),
    "network-recorded": Case(
        f"network --out out {_pairs('left-stage', 'right-stage', 'left-side')} --distance left,stage,2.35m"
    ),
    "network-refused": Case(f"network --out out {_pairs('left-stage', 'right-side')}", 4),
    "board": Case(f"board {_BOARD} {_BOARD_RIG} {_set(rig__board='{square_m: 0.06}')} --captures 3"),
    "board-recorded": Case(f"board {_BOARD} {_boards(3, 1, 2)}"),
    "board-refused": Case(f"board {_BOARD} {_boards(1, 2)}", 4),
    "board-not-found": Case(f"board --out out --board chessboard:8x6 --square 60mm {_boards(1, 2, 3)}", 2),
    "board-and-corner": Case(f"calibrate old/scan-board-rig/out old/board/out --out out {_BOARD_RIG}"),
    "board-printed": Case("board --print charuco:A4 --out board.pdf"),
    "live": Case(f"live --out out {_THING} {_NO_NOISE} {_THING_RIG} --clouds 3"),
    "live-room": Case(f"live --out out {_ROOM} {_NO_NOISE} --room --clouds 2 --calibration old/room/out/truth.yaml"),
    "live-joined": Case(f"object --out out {_THING} {_THING_RIG} old/live/out"),
    "live-refused": Case(f"live --out out {_THING} {_THING_RIG} --clouds 2 {_set(rig__exposure_us=1)}", 4),
}
_FOREIGN = {
    "photographed-room": Case(
        f"--out out --config configs/room-sim.yaml {_sizes((800, 600), (214, 120))} {_QUICK} --captures 3 "
        f"{_set(rig__wallpaper='true', rig__furniture='false', rig__interreflection='false', rig__ambient=2)}"
    ),
    "photos": Case("photos --out out inputs/photos/0.png inputs/photos/1.png inputs/photos/2.png"),
    "photos-dense": Case(
        "photos --out out --dense inputs/photos/0.png inputs/photos/1.png --set corner.squareness_deg=0"
    ),
    "photos-refused": Case("photos --out out inputs/photos/0.png inputs/photos/0-again.png", 4),
    "video": Case(f"patterns --out out {_FILM} --video sequence.mp4 --hold 0.1s"),
    "filmed-room": Case(f"--out out {_FILM}"),
    "film": Case("import inputs/film/film.mp4 --sequence old/video/out/sequence.yaml --out out"),
    "film-replayed": Case(f"replay --out out old/film/out {_FILM}"),
    "film-refused": Case("import inputs/film/cut.mp4 --sequence old/video/out/sequence.yaml --out out", 2),
    "import": Case("import inputs/foreign --projector 640x360 --out out"),
    "import-replayed": Case("replay --out out old/import/out"),
    "import-refused": Case("import inputs/foreign-short --projector 640x360 --out out", 2),
}
_AFTERWARDS = {
    "check": Case(f"check {_CORNER} {_SQUARE}"),
    "check-refused": Case(f"check {_CORNER}", 4),
    "check-undecodable": Case(f"check --out out {_THING}", 4),
    "measure": Case("measure old/scan-balls/out --out out --shares --sphere 0.24m --distance 209 113 138 153"),
    "measure-refused": Case("measure old/scan-refused/out --out out", 2),
    "accept": Case("accept old/scan-balls/out --out out --ball-bar 240mm,240mm,500mm"),
    "compare": Case("compare old/scan/out old/scan-square/out --out out"),
    "export-refused": Case("export old/scan-refused/out --to ply --out cloud.ply", 2),
    "clean": Case("clean old/scan-balls/out"),
    "clean-refused": Case("clean old/scan-balls/out --box=90,90,90,91,91,91", 2),
    "section": Case("section old/scan-balls/out --plane y=0 --every 0.1 --out out"),
    "new": Case("new my-rig.yaml"),
    "help": Case("--help"),
} | {
    f"export-{case}-{kind}{ending}": Case(f"export old/{case}/out --to {kind} --out out{ending}")
    for case, kind, ending in (
        ("scan-balls", "opencv", ".yaml"),
        ("scan-balls", "colmap", ""),
        ("scan-balls", "ply", ".ply"),
        ("scan-balls", "e57", ".e57"),
        ("scan-balls", "mesh", ".glb"),
        ("scan-balls", "mesh", ".obj"),
        ("room", "colmap", ""),
        ("room", "e57", ".e57"),
        ("room", "mesh", ".glb"),
        ("object", "stl", ".stl"),
        ("object", "3mf", ".3mf"),
        ("network", "mapping", ""),
    )
}
CASES = _SCANS | _RECORDINGS | _SEVERAL | _FOREIGN | _AFTERWARDS


def recordings_in(folders: Iterable[Path]) -> dict[str, Case]:
    """A replay of each recording in some folders, with the calibration that is beside it."""
    cases = {}
    for folder in folders:
        for listing in sorted(folder.rglob("capture.yaml")):
            recording = listing.parent.resolve()
            given = recording / "calibration.yaml"
            calibrated = f" --calibration '{given}'" if given.is_file() else ""
            cases[f"recording-{recording.name}"] = Case(f"replay --out out '{recording}'{calibrated}")
    return cases
