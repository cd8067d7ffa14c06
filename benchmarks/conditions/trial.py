"""One condition in one room with one sequence, through the whole program."""

import contextlib
import io
import tempfile
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import yaml

from calib.geometry import Matches, Size
from conditions.captures import Capture, patterns_of, take
from conditions.catalogue import AMBIENT, Condition, conditions
from conditions.judging import (
    MOST_MATCH_SIGMAS,
    Truth,
    calibration_error,
    could_be_decoded,
    match_errors,
    matched_share,
)
from conditions.plain_decoder import plain_matches
from hw.settings import PanelSettings, SimulatedRigSettings
from hw.simulated import SimulatedRoom, panel_homography
from scanner.commands import main as scan
from scanner.io import MATCHES_FILE, read_calibration, read_matches, write_calibration
from scanner.patterns import Phase
from scanner.results import CALIBRATION_FILE, read_verdict

_UNRESOLVED_BITS = 3  # number of finest bits that a plain decoder may leave out


@dataclass(frozen=True)
class Setup:
    """Sizes are (width, height)."""

    seed: int
    sequence: str
    camera_size: tuple[int, int]
    projector_size: tuple[int, int]


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial. Shares and errors are None without matches or a calibration.

    `decodable`: whether a refused capture could have been decoded; None if it was not refused. `match_sigmas`: errors
    of matches in their sigmas, the median and the 90 % quantile.
    """

    name: str
    strength: str
    seed: int
    sequence: str
    exit_code: int
    message: str
    grade: str | None = None
    matched: float | None = None
    match_median_px: float | None = None
    match_99_px: float | None = None
    percent: tuple[float, ...] | None = None
    sigmas: tuple[float, ...] | None = None
    wrong: bool = False
    decodable: bool | None = None
    match_sigmas: tuple[float, float] | None = None


def run(condition: Condition, setup: Setup, keep: Path | None = None) -> Outcome:
    """Take the capture, replay it, and judge the result.

    `keep`: a folder where capture, configuration and result are kept; None deletes them.
    """
    capture, truth = captured(condition, setup)
    with contextlib.ExitStack() as temporary:
        if keep is None:
            place = Path(temporary.enter_context(tempfile.TemporaryDirectory(prefix="conditions-")))
        else:
            place = keep / f"{condition.name} {condition.strength} {setup.sequence} {setup.seed}".replace("/", "-")
        calibrated = len({pattern.axis for pattern in capture.patterns if hasattr(pattern, "axis")}) == 1
        if not condition.imported:
            capture.write(place / "capture")
            code, message = 0, ""
        else:
            capture.write_frames(place / "frames")
            size = "{}x{}".format(*capture.projector_size)
            code, message = _scan("import", place, "frames", "--out", place / "capture", "--projector", size)
        if code == 0:
            code, message = _replayed(place, truth, calibrated=calibrated)
        figures = _figures(place / "result", truth, calibrated=calibrated)
    decodable = None if code == 0 else could_be_decoded(plain_decodings(capture, truth), truth, calibrated=calibrated)
    wrong = figures.pop("wrong", False) and code == 0
    about = (condition.name, condition.strength, setup.seed, setup.sequence)
    return Outcome(*about, code, message, wrong=wrong, decodable=decodable, **figures)


def captured(condition: Condition, setup: Setup) -> tuple[Capture, Truth]:
    """The reproducible capture of a condition, and the ground truth of its first frame."""
    shown = condition.shown or partial(patterns_of, setup.sequence)
    patterns = shown(setup.projector_size)
    rng = np.random.default_rng([setup.seed, crc32(f"{condition.name} {condition.strength} {setup.sequence}".encode())])
    settings = condition.settings(patterns, rng)
    seen = setup.seed, Size(*setup.camera_size), Size(*setup.projector_size), settings.pop("furniture_askew_deg", 0.0)
    room = _room(*seen).under(**settings)
    capture = take(room, patterns, condition.exposed(room))
    if condition.frames is not None:
        capture = condition.frames(capture, rng)
    truth = _truth(*seen, tuple(settings.get("panel", {}).items()))
    return capture, truth.moved(capture.moved_px) if any(capture.moved_px) else truth


def named(name: str, strength: str) -> Condition:
    """A condition of the catalogue."""
    (found,) = [condition for condition in conditions() if (condition.name, condition.strength) == (name, strength)]
    return found


@lru_cache(maxsize=3)
def _room(seed: int, camera_size: Size, projector_size: Size, askew_deg: float) -> SimulatedRoom:
    settings = SimulatedRigSettings(seed=seed, ambient=AMBIENT, furniture_askew_deg=askew_deg)
    return SimulatedRoom(settings, camera_size, projector_size)


@lru_cache(maxsize=8)
def _truth(
    seed: int, camera_size: Size, projector_size: Size, askew_deg: float, panel: tuple[tuple[str, object], ...]
) -> Truth:
    room = _room(seed, camera_size, projector_size, askew_deg)
    shown = room.under(panel=dict(panel))
    projector_px = shown.ground_truth().projector_px.astype(np.float64)
    true = shown.calibration
    if true is None or np.ptp(true.projector.focal_px) > 1e-6 * true.projector.focal_px[0]:
        shape = panel_homography(PanelSettings.model_validate(dict(panel)), *projector_size)
        return Truth(projector_px, room.calibration, pinhole=False, panel=shape)
    return Truth(projector_px, true)


def plain_decodings(capture: Capture, truth: Truth) -> list[Matches]:
    """Decodings by the plain decoder; for a Gray code alone, also without its finest bits."""
    alone = not any(isinstance(pattern, Phase) for pattern in capture.patterns)
    unresolved = range(_UNRESOLVED_BITS + 1 if alone else 1)
    plain = partial(plain_matches, capture.patterns, capture.frames, calibration=truth.calibration)
    return [plain(without_bits=bits) for bits in unresolved]


def _replayed(place: Path, truth: Truth, *, calibrated: bool) -> tuple[int, str]:
    """Exit code and stderr of `scan replay`; one axis is replayed with the true calibration."""
    known = {"known": [float(value) for value in truth.calibration.camera.principal_point_px]}
    configuration = {"camera": {"principal_point": known}, "corner": {"squareness_deg": 0}}
    (place / "rig.yaml").write_text(yaml.safe_dump(configuration), encoding="utf-8")
    options: list[str | Path] = ["--config", place / "rig.yaml", "--out", place / "result"]
    if calibrated:
        write_calibration(place / "known.yaml", truth.calibration)
        options += ["--calibration", place / "known.yaml"]
    return _scan("replay", place, "capture", *options)


def _scan(command: str, place: Path, folder: str, *options: str | Path) -> tuple[int, str]:
    """Exit code and stderr of a command on a folder."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        code = scan([command, str(place / folder), *map(str, options), "--quiet"])
    return code, said.getvalue().replace(str(place), "").strip()


def _figures(result: Path, truth: Truth, *, calibrated: bool) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    if (result / MATCHES_FILE).exists():
        matches = read_matches(result / MATCHES_FILE)
        errors = match_errors(matches, truth)
        figures["matched"] = matched_share(matches, truth)
        if errors.size:
            figures["match_median_px"] = float(np.median(errors))
            figures["match_99_px"] = float(np.percentile(errors, 99))
        if errors.size and matches.sigma_px is not None:
            relative = match_errors(matches, truth, in_sigmas=True)
            figures["match_sigmas"] = tuple(float(np.percentile(relative, share)) for share in (50, 90))
    if calibrated and "match_sigmas" in figures:
        figures["wrong"] = figures["match_sigmas"][0] > MOST_MATCH_SIGMAS
    if not (result / CALIBRATION_FILE).exists():
        return figures
    verdict = read_verdict(result / CALIBRATION_FILE)
    figures["grade"] = verdict.grade if verdict else None
    if not calibrated:
        error = calibration_error(read_calibration(result / CALIBRATION_FILE), truth)
        figures["percent"], figures["sigmas"] = tuple(error.percent.tolist()), tuple(error.sigmas.tolist())
        figures["wrong"] = error.is_wrong
    return figures
