"""The matches file is written during the calibration, and becomes part of the result."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_matches
from scanner.reconstruction.save import EarlyMatches
from scanner.results import Decoded
from tests.support.cloud_scene import room
from tests.support.result_folder import calibrated_report


@pytest.fixture(scope="module")
def capture() -> Decoded:
    return calibrated_report(room()).outcome.decoded


def test_unchanged_matches_are_written_once(tmp_path: Path, capture: Decoded) -> None:
    with EarlyMatches(tmp_path) as ahead:
        ahead.begin([capture])
        ahead.write(tmp_path, capture)
        first = (tmp_path / MATCHES_FILE).stat()
        ahead.write(tmp_path, replace(capture, name="another name"))
    assert (tmp_path / MATCHES_FILE).stat() == first
    assert len(read_matches(tmp_path)) == len(capture.matches)


def test_they_are_written_in_the_background_at_a_priority_of_their_own(tmp_path: Path, capture: Decoded) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with EarlyMatches(tmp_path) as ahead:
        ahead.begin([capture])
    assert len(read_matches(tmp_path)) == len(capture.matches)
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


def test_relabelled_matches_are_written_again(tmp_path: Path, capture: Decoded) -> None:
    face = np.where(capture.matches.labels == 0, 1, capture.matches.labels).astype(np.int32)
    with EarlyMatches(tmp_path) as ahead:
        ahead.begin([capture])
        ahead.write(tmp_path, capture.with_matches(capture.matches.with_faces(face), capture.plane))
    assert read_matches(tmp_path).on_each_face[0] == 0 < capture.matches.on_each_face[0]


def test_several_captures_are_not_written_ahead(tmp_path: Path, capture: Decoded) -> None:
    with EarlyMatches(tmp_path) as ahead:
        ahead.begin([capture, capture])
        assert not (tmp_path / MATCHES_FILE).exists()
        ahead.write(tmp_path / "first", capture)
    assert [path.parent.name for path in tmp_path.rglob(MATCHES_FILE)] == ["first"]


def test_a_write_error_is_raised_when_the_file_is_needed(tmp_path: Path, capture: Decoded) -> None:
    (tmp_path / MATCHES_FILE).mkdir()
    with EarlyMatches(tmp_path) as ahead:
        ahead.begin([capture])
        with pytest.raises(InputError, match=f"{MATCHES_FILE}: is a folder"):
            ahead.write(tmp_path, capture)
