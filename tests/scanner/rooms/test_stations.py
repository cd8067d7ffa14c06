"""Messages of `scan room` and `--stations`: foreign stations, wrong input, where to go.

A full disk while a room is written: the path is named, and nothing incomplete remains.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from calib.geometry import Calibration, Size
from calib.registration import Registration, StationView, register
from scanner.capture import CaptureMetadata
from scanner.commands import main
from scanner.configuration import Config
from scanner.errors import StorageError
from scanner.io import write_calibration, write_matches
from scanner.results import Decoded, GivenMatches, new_result
from scanner.rooms import jobs, solve
from scanner.rooms.jobs import scan_room
from scanner.rooms.save import save_room
from scanner.rooms.solve import segment_capture, solve_room
from scanner.stations import RigStart, given_rig, read_stations
from scanner.ui import Terminal
from tests.scanner.rooms.conftest import CAMERA, SolvedExample
from tests.support.little_memory import no_file_larger_than
from tests.support.whole_room import PROJECTOR, TrueStation, stations, with_turned_projector

QUIET = Terminal(quiet=True)


def test_a_station_of_another_room_is_named_and_left_out(example: SolvedExample, tmp_path: Path) -> None:
    elsewhere = stations(6, 2, camera=CAMERA, furniture_askew_deg=4.0)[4]
    truth = example.true[0].calibration
    write_calibration(tmp_path / "rig.yaml", truth)
    # The same rig in the other room: what its camera saw, as its projector would have lit it.
    seen = elsewhere.calibration.camera.project(elsewhere.points)
    inside = np.all((seen > 0) & (seen < np.array(CAMERA) - 1), axis=1)
    thrown = truth.projector.project(truth.pose @ elsewhere.points)
    camera_px = truth.camera.project(elsewhere.points)
    inside &= np.all((thrown > 0) & (thrown < np.array(PROJECTOR) - 1), axis=1) & np.all(
        (camera_px > 0) & (camera_px < np.array(CAMERA) - 1), axis=1
    )
    matches = replace(
        elsewhere.matches,
        camera_px=camera_px[inside],
        projector_px=thrown[inside] + 0.03 * np.random.default_rng(0).standard_normal((inside.sum(), 2)),
        sigma_px=np.full(inside.sum(), 0.03),
    )
    write_matches(tmp_path / "elsewhere.npz", matches)
    captures = read_stations([example.files[0], tmp_path / "elsewhere.npz", example.files[3]], example.config, QUIET)
    solved = solve_room(captures, given_rig(tmp_path / "rig.yaml", example.config), example.config, QUIET)
    assert [stranger.name for stranger in solved.outlier_stations] == [str(tmp_path / "elsewhere.npz")]
    assert solved.outlier_stations[0].finding.kind.name in ("another-room", "no-overlap")  # and of the same rig
    assert {station.name for station in solved.stations} == {str(example.files[k]) for k in (0, 3)}


def test_rejected_stations_are_retried_with_the_estimated_rig(
    example: SolvedExample, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = read_stations([example.files[k] for k in (0, 2, 3)], example.config, QUIET)
    known = example.solved.calibration
    given = known.in_baselines
    rigs: list[Calibration] = []

    def looked_at(capture: Decoded, rig: Calibration) -> solve.CaptureView:
        rigs.append(rig)
        return segment_capture(capture, rig)

    def at_first_without_the_last(views: Sequence[StationView], of_another_rig: Mapping[int, str]) -> Registration:
        assert not of_another_rig
        return register(views if len(rigs) > len(captures) else views[:-1])

    monkeypatch.setattr(solve, "segment_capture", looked_at)
    monkeypatch.setattr(solve, "register", at_first_without_the_last)
    solved = solve_room(captures, RigStart(given, example.solved.uncertainty, {}, known), example.config, QUIET)
    assert len(solved.stations) == len(captures)
    assert len(rigs) == 2 * len(captures)
    assert rigs[-1].camera.focal_px != rigs[0].camera.focal_px
    assert rigs[-1].camera.focal_px[0] == pytest.approx(known.camera.focal_px[0], rel=2e-3)


def test_a_changed_rig_is_left_out_even_if_its_surfaces_fit(example: SolvedExample, tmp_path: Path) -> None:
    truth = example.true[0].calibration
    write_calibration(tmp_path / "rig.yaml", truth)
    write_matches(tmp_path / "changed.npz", with_turned_projector(example.true[3], (0.1, 0.0, 0.1)).matches)
    captures = read_stations([example.files[0], tmp_path / "changed.npz", example.files[2]], example.config, QUIET)
    solved = solve_room(captures, given_rig(tmp_path / "rig.yaml", example.config), example.config, QUIET)
    assert [
        (outlier_station.name, outlier_station.finding.kind.name) for outlier_station in solved.outlier_stations
    ] == [(str(tmp_path / "changed.npz"), "changed-rig")]
    assert {station.name for station in solved.stations} == {str(example.files[k]) for k in (0, 2)}
    (told,) = jobs._guidance(captures[:2], truth)
    assert "was taken with another rig" in told
    assert "epipolar" in told


@pytest.mark.parametrize(
    ("stations", "expected"),
    [
        (["nothing-there"], "nothing-there"),
        (["station-0.npz"], "two stations or more, found 1"),
        (["station-0.npz", "station-0.npz"], "given twice"),
    ],
)
def test_wrong_input_gives_one_sentence(
    example: SolvedExample, tmp_path: Path, capsys: pytest.CaptureFixture[str], stations: Sequence[str], expected: str
) -> None:
    config = tmp_path / "rig.yaml"
    config.write_text(f"camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}}}\nprojector: {{width: 854, height: 480}}\n")
    paths = [str(example.files[0].parent / name) for name in stations]
    assert main(["room", *paths, "--config", str(config), "--out", str(tmp_path / "out")]) == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_open3d_nothing_is_started(
    example: SolvedExample, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> object:
        raise OSError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr("calib.deferred_imports.import_module", missing)
    with pytest.raises(Exception, match=r"libGL\.so\.1.*apt-get install libgl1 .*libgomp1"):
        scan_room(example.config, tmp_path / "out", stations=example.files)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("pair_s", "compared"), [(0.0, 24), (0.1, 24), (0.2, 17), (2.0, 6), (100.0, 2)])
def test_live_compares_with_as_many_stations_as_time_allows(pair_s: float, compared: int) -> None:
    """With 24 stations; every compared pair takes time."""
    comparison = jobs.StationComparison(30.0, pair_s)
    assert comparison.within_patience(24) == compared
    assert comparison.within_patience(2) == 2
    assert comparison.within_patience(1) == 1


@pytest.mark.parametrize(("count", "pairs"), [(1, 1), (2, 1), (3, 3), (5, 10), (7, 3)])
def test_live_takes_note_of_how_long_a_pair_takes(monkeypatch: pytest.MonkeyPatch, count: int, pairs: int) -> None:
    """Twelve seconds for all of five stations: of seven, only three are compared then."""
    now_s = [100.0]
    monkeypatch.setattr("scanner.rooms.jobs.time.monotonic", lambda: now_s[0])
    chosen = list[int]()

    def compare(captures: Sequence[Decoded], calibration: Calibration) -> list[str]:
        chosen.append(len(captures))
        now_s[0] += 12.0
        return ["turned"]

    comparison = jobs.StationComparison(4.0, compare=compare)
    captures = cast(Sequence[Decoded], range(count))
    if count == 7:
        comparison.pair_s = 1.2
    assert comparison.guidance(captures, cast(Calibration, None)) == ["turned"]
    assert chosen == [3 if count == 7 else count]
    assert comparison.pair_s == pytest.approx(12.0 / pairs)


def test_live_reports_overlap_and_where_to_turn(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = stations(6, 1, camera=CAMERA, furniture_askew_deg=4.0)[2:5]
    rig = {"backend": "simulated", "room": "whole"}
    sizes = {"camera": dict(zip(("width", "height"), CAMERA, strict=True)), "projector": {"width": 854, "height": 480}}
    config = Config.model_validate({"rig": rig, **sizes})

    def take(rig: object, config: object, folder: Path, progress: object, name: str) -> Decoded:
        station: TrueStation = true[len(list(folder.parent.iterdir())) - 1]
        return Decoded(CaptureMetadata(Size(*CAMERA), Size(*PROJECTOR)), station.matches, GivenMatches(), name)

    monkeypatch.setattr("scanner.stations.take", take)
    captures, start = jobs.take_room(config, 3, tmp_path, Terminal())
    assert [capture.name for capture in captures] == ["Station 1", "Station 2", "Station 3"]
    assert start.corners
    told = " ".join(capsys.readouterr().out.split())
    assert "Station 2 overlaps Station 1 by 3" in told
    assert "Station 3 overlaps Station 2 by 2" in told
    assert "to the left; a third of what it sees stays the same" in told  # they go round against the clock


def test_a_full_disk_leaves_no_incomplete_room(example: SolvedExample, tmp_path: Path) -> None:
    out = tmp_path / "room"
    with (
        pytest.raises(StorageError) as caught,
        new_result(out, Config(), overwrite=False) as folder,
        no_file_larger_than(1_000_000),
    ):
        save_room(example.solved, folder, Config(), Terminal(quiet=True))
    assert str(out) in str(caught.value)
    assert "partial" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
