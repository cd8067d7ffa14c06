"""Compile what the commands will need, so that the first of them does not wait for it: part of `make setup`.

Numba compiles a function for the types that it is called with, so each way through the program is gone once, with
small pictures of a simulated room. Two processes share the work: one decodes frames, the other begins with matches
that are true. What is compiled already, and has not changed since, is not compiled again.
"""

import gc
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numba.core import event

from calib.geometry import Matches, Size
from hw.open_rig import open_rig
from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import SimulatedRoom
from scanner.acquisition import decode
from scanner.capture import CaptureMetadata, capture
from scanner.configuration import Config
from scanner.exporting import FORMATS, ExportRequest
from scanner.patterns import PRESETS, Phase
from scanner.reconstruction import reconstruct
from scanner.reconstruction.keystone.beat import planes_at
from scanner.results import Decoded, GivenMatches, new_result
from scanner.ui import Terminal

_CAMERA_SIZE, _PROJECTOR_SIZE = Size(306, 256), Size(427, 240)
_CONFIG = Config.model_validate(
    {
        "camera": {"width": 306, "height": 256, "principal_point": {"known": [157.0375, 131.7875]}},
        "projector": {"width": 427, "height": 240},
        "corner": {"squareness_deg": 0, "same": True},
    }
)
# Light between surfaces takes seconds to solve, and nothing compiled depends on it.
_ROOMS = [SimulatedRigSettings(pose=pose, interreflection=False, ambient=0, furniture=False) for pose in range(2)]
_ERROR_PX = 0.05
_QUIET = Terminal(quiet=True)


def run() -> None:
    """Compile."""
    begun_s = time.monotonic()
    if sys.stderr.isatty():
        print("Compiling for this machine …", file=sys.stderr)
    with ProcessPoolExecutor(2) as processes:
        compiled = sum(processes.map(_counted, (_from_frames, _from_matches)))
    print(f"Compiled for this machine: {compiled} functions, {time.monotonic() - begun_s:.0f} s", file=sys.stderr)


class _Count(event.Listener):
    """Counts compilations."""

    def __init__(self) -> None:
        self.compiled = 0

    def on_start(self, _event: event.Event) -> None:
        self.compiled += 1

    def on_end(self, _event: event.Event) -> None:
        """It has been counted."""


def _counted(work: Callable[[], None]) -> int:
    """How many functions the work had to be compiled for."""
    gc.disable()  # the compiler makes millions of small objects, and the process ends soon
    listener = _Count()
    event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
    work()
    return listener.compiled


def _from_frames() -> None:
    """Decode every preset, and codes without fringes, for which the calibration has to be known."""
    with open_rig(_ROOMS[1], _CAMERA_SIZE, _PROJECTOR_SIZE) as opened:
        for preset in PRESETS.values():
            (decoded,) = decode([capture(opened.rig, preset.patterns(_PROJECTOR_SIZE))], _QUIET, "Decoding")
            matches = decoded.matches
        planes_at(matches.camera_px, matches.camera_px, np.zeros(len(matches.camera_px), np.int32))  # as keystone asks
        standard = PRESETS["standard"].patterns(_PROJECTOR_SIZE)
        codes = tuple(pattern for pattern in standard if not isinstance(pattern, Phase))
        decode([capture(opened.rig, codes)], _QUIET, "Decoding", calibration=opened.truth)


def _from_matches() -> None:
    """Calibrate and reconstruct from two places, with reports, and export."""
    with TemporaryDirectory(prefix="roomscan-") as scratch:
        out = Path(scratch) / "result"
        with new_result(out, _CONFIG, overwrite=False, tell=_QUIET.note) as folder:
            reconstruct([_true_matches(room) for room in _ROOMS], _CONFIG, folder, _QUIET)
        FORMATS["mesh"].write(ExportRequest(out, out.with_suffix(".ply"), False))


def _true_matches(settings: SimulatedRigSettings) -> Decoded:
    """What is to be decoded, with noise, in the types in which the decoder gives it."""
    room = SimulatedRoom(settings, _CAMERA_SIZE, _PROJECTOR_SIZE)
    pixels = room.ground_truth().projector_px
    rows, columns = np.nonzero(np.isfinite(pixels).all(axis=2))
    noise = np.random.default_rng(settings.pose).normal(0, _ERROR_PX, (len(rows), 2))
    matches = Matches(
        np.stack([columns, rows], axis=1).astype(np.float32),
        (pixels[rows, columns] + noise).astype(np.float32),
        sigma_px=np.full(len(rows), _ERROR_PX, np.float32),
    )
    width, height = _PROJECTOR_SIZE
    white = room.renderer.render(np.full((height, width), 255, np.uint8))
    photograph = np.clip(255 / white.max() * white, 0, 255).astype(np.uint8)
    metadata = CaptureMetadata(_CAMERA_SIZE, _PROJECTOR_SIZE, PRESETS["standard"].patterns(_PROJECTOR_SIZE))
    return Decoded(metadata, matches, GivenMatches(photograph), f"Capture {settings.pose + 1}")


if __name__ == "__main__":
    run()
