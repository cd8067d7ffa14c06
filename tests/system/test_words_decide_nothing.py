"""Grades, exit codes and files are the same if every message and advice is replaced by random words.

Whoever grades, guides or filters must read the kind of a finding and its numbers: the words are for people.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.finding import Finding, Severity
from calib.geometry import Matches
from calib.self_calibration import SelfCalibration
from calib.synthetic import random_captures
from scanner.capture import CHANGED_SHAPE
from scanner.decoding import TOO_DARK, UNCHECKED, UNSEEN_MOTION
from scanner.io import write_matches, write_png
from scanner.patterns import draw
from scanner.reporting import ReportInput, verdict
from scanner.results import GivenCalibration, Reconstructed, SelfCalibrated, read_verdict
from tests.support import small_capture
from tests.support.cloud_scene import room
from tests.support.command_line import run
from tests.support.findings import Decision, decided_alike, scramble_words
from tests.support.known_rigs import SMALL_CAMERA
from tests.support.result_folder import calibrated_report, refused_report
from tests.support.small_capture import PATTERNS, SIZE, read_listing, write_capture, write_listing

CONFIG = """
camera: {{width: 612, height: 512, principal_point: {{known: [313.7, 263.2]}}}}
projector: {{width: 854, height: 480}}
corner: {{squareness_deg: {squareness_deg}}}
method: {method}
"""

pytestmark = pytest.mark.xdist_group("words")


@pytest.fixture(scope="module")
def report() -> ReportInput:
    return calibrated_report(room())


def calibrated(report: ReportInput, *findings: Finding, focal_sigma: float = 0.005, **solution: object) -> ReportInput:
    """A report of the capture with these findings of its decoder, and this sigma of its focal lengths."""
    assert isinstance(report.outcome, Reconstructed)
    stage = report.outcome.calibrated
    assert isinstance(stage, SelfCalibrated)
    assert stage.decoded.decoding is not None
    known = stage.calibration
    sigma = replace(
        known.sigma,
        camera=replace(known.sigma.camera, focal_px=(focal_sigma * known.camera.focal_px[0],) * 2),
        projector=replace(known.sigma.projector, focal_px=(focal_sigma * known.projector.focal_px[0],) * 2),
    )
    decoded = replace(stage.decoded, origin=replace(stage.decoded.decoding, findings=findings))
    solved: SelfCalibration = replace(stage.solution, **solution)  # type: ignore[arg-type]
    outcome = replace(stage, decoded=decoded, calibration=replace(known, sigma=sigma), solution=solved)
    return replace(report, outcome=replace(report.outcome, calibrated=outcome))


def given(report: ReportInput, *findings: Finding) -> ReportInput:
    """The same with a calibration that was given."""
    stage = calibrated(report, *findings).outcome
    assert isinstance(stage, Reconstructed)
    return replace(report, outcome=replace(stage, calibrated=GivenCalibration(stage.decoded, stage.calibration)))


def warning(kind: object) -> Finding:
    return Finding(kind, Severity.WARNING, "Words that a person reads.", "Do this.")  # type: ignore[arg-type]


VERDICTS: list[tuple[str, Callable[[ReportInput], ReportInput], str]] = [
    ("well calibrated", calibrated, "good"),
    ("poorly calibrated", lambda report: calibrated(report, focal_sigma=0.02), "fair"),
    ("in the dark", lambda report: calibrated(report, warning(TOO_DARK)), "good"),
    ("with a changed shape", lambda report: calibrated(report, warning(CHANGED_SHAPE)), "fair"),
    (
        "with unseen motion",
        lambda report: calibrated(report, findings=(warning(UNSEEN_MOTION),)),
        "fair",
    ),
    ("moving much", lambda report: calibrated(report, possible_percent=3.0), "fair"),
    ("given", given, "good"),
    ("given, unchecked", lambda report: given(report, warning(UNCHECKED)), "fair"),
    ("refused", lambda _: refused_report(room()), "refused"),
]


@pytest.mark.parametrize(("name", "made", "grade"), VERDICTS, ids=[name for name, _, _ in VERDICTS])
def test_the_grade_of_a_capture_is_not_in_its_words(
    report: ReportInput, name: str, made: Callable[[ReportInput], ReportInput], grade: str
) -> None:
    assert decided_alike(lambda: verdict(made(report))).grade == grade, name


def two_captures(folder: Path) -> list[object]:
    """Arguments that calibrate from two captures of one corner."""
    captures = random_captures(np.random.default_rng(5), 2, camera=SMALL_CAMERA, count=1500, noise_px=0.05)
    return calibrate(folder, *(capture.matches for capture in captures))


def one_place(folder: Path) -> list[object]:
    """The same of one place, twice."""
    (capture,) = random_captures(np.random.default_rng(5), 1, camera=SMALL_CAMERA, count=1500, noise_px=0.05)
    off = np.random.default_rng(6).normal(0, 0.05, capture.matches.projector_px.shape)
    again = replace(capture.matches, projector_px=capture.matches.projector_px + off)
    return calibrate(folder, capture.matches, again)


def slanted_walls(folder: Path) -> list[object]:
    """Two captures of walls that are farther from square than was allowed for."""
    captures = random_captures(
        np.random.default_rng(5), 2, camera=SMALL_CAMERA, count=1500, noise_px=0.05, walls_off_deg=1.5
    )
    return calibrate(folder, *(capture.matches for capture in captures), squareness_deg=0.3)


def stretched(folder: Path) -> list[object]:
    """A projector that squeezes its picture, before a corner that is taken as square."""
    (capture,) = random_captures(np.random.default_rng(5), 1, camera=SMALL_CAMERA, count=1500, noise_px=0.05)
    matches = replace(capture.matches, projector_px=capture.matches.projector_px * (1.0, 0.8))
    return calibrate(folder, matches)


def by_the_paper(folder: Path) -> list[object]:
    """The paper's method."""
    (capture,) = random_captures(np.random.default_rng(5), 1, camera=SMALL_CAMERA, count=1500, noise_px=0.05)
    return calibrate(folder, capture.matches, method="paper")


def flat_wall(folder: Path) -> list[object]:
    """A camera that looks at a flat wall."""
    pixels = np.random.default_rng(1).uniform((0, 0), (611, 511), (3000, 2))
    return calibrate(folder, Matches(pixels, 0.8 * pixels))


def hardly_any(folder: Path) -> list[object]:
    """Two dozen matches."""
    (capture,) = random_captures(np.random.default_rng(5), 1, camera=SMALL_CAMERA, count=1500, noise_px=0.05)
    return calibrate(folder, Matches(capture.matches.camera_px[::60], capture.matches.projector_px[::60]))


def calibrate(folder: Path, *captures: Matches, squareness_deg: float = 0.0, method: str = "refined") -> list[object]:
    (folder / "rig.yaml").write_text(CONFIG.format(squareness_deg=squareness_deg, method=method))
    files = [folder / f"{number}.npz" for number in range(len(captures))]
    for file, matches in zip(files, captures, strict=True):
        write_matches(file, matches)
    return ["calibrate", *files, "--config", folder / "rig.yaml"]


def recording(folder: Path) -> list[object]:
    """Arguments that replay frames of a camera that sees what the projector shows, which is flat."""
    return ["replay", write_capture(folder / "capture")]


def in_the_dark(folder: Path) -> list[object]:
    """The same with hardly any light: whatever it is refused for, darkness may be the cause."""
    capture = write_capture(folder / "capture")
    for number, pattern in enumerate(PATTERNS):
        write_png(capture / f"frames/{number:03d}.png", draw(pattern, SIZE) // 60 + 20)
    return ["replay", capture]


def simulated(folder: Path) -> list[object]:
    """A scan of a simulated room."""
    (folder / "room.yaml").write_text(small_capture.CONFIG)
    return ["--config", folder / "room.yaml"]


def broken_off(folder: Path) -> list[object]:
    """A recording that lacks its last frames, of which one is damaged."""
    capture = write_capture(folder / "capture")
    listing = read_listing(capture)
    listing["sequence"] = [frame["pattern"] for frame in listing["frames"]]
    listing["frames"] = listing["frames"][:-2]
    write_listing(capture, listing)
    for number in (len(PATTERNS) - 2, len(PATTERNS) - 1):
        (capture / f"frames/{number:03d}.png").unlink()
    (capture / f"frames/{len(PATTERNS) - 3:03d}.png").write_bytes(b"")
    return ["replay", capture]


@pytest.mark.parametrize(
    ("made", "code"),
    [
        (simulated, 0),
        (two_captures, 0),
        (one_place, 0),
        (slanted_walls, 0),
        (by_the_paper, 0),
        (stretched, 4),
        (flat_wall, 4),
        (hardly_any, 4),
        (recording, 4),
        (in_the_dark, 4),
        (broken_off, 4),
    ],
)
def test_exit_code_and_files_are_not_in_the_words(
    made: Callable[[Path], list[object]], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_capture.with_few_rays(monkeypatch)
    arguments = made(tmp_path)
    outcome = run(*arguments, "--out", tmp_path / "told", "--quiet"), results_in(tmp_path / "told")
    assert outcome[0] == code
    scramble_words(monkeypatch)
    assert (run(*arguments, "--out", tmp_path / "odd", "--quiet"), results_in(tmp_path / "odd")) == outcome


def results_in(folder: Path) -> dict[str, Decision | None]:
    """All files of a result, and what those say that have a verdict."""
    decisions: dict[str, Decision | None] = {}
    for path in sorted(folder.rglob("*")):
        has_verdict = path.suffix == ".yaml" and "verdict" in (yaml.safe_load(path.read_text()) or {})
        stated = read_verdict(path) if has_verdict else None
        decisions[path.relative_to(folder).as_posix()] = Decision.of(stated) if stated else None
    return decisions
