"""The log of a calibration: what was in use when, as differences from the first."""

from pathlib import Path

import numpy as np
import pytest

from scanner.errors import InputError
from scanner.results.calibration_log import LOGGED, differences, log_of, log_text, read_log
from tests.support.calibration_logs import TOUCHED, drifting, write_logged

_BY_NAME = {parameter.name: parameter for parameter in LOGGED}


def test_a_log_reads_back_the_same(tmp_path: Path) -> None:
    entries = [entry for _, entry in drifting()]
    assert read_log(log_of(write_logged(tmp_path))) == entries
    assert log_text(entries[:1]) == log_text(entries)[: len(log_text(entries[:1]))]
    assert read_log(tmp_path / "none.log.yaml") == []


def test_differences_are_from_the_first_in_units_for_people() -> None:
    entries = [entry for _, entry in drifting()]
    ((zoom, sigma),) = differences(entries, _BY_NAME["projector_focal_px"])
    np.testing.assert_allclose(zoom, np.where(np.arange(len(entries)) >= TOUCHED, 0.5, 0.0), atol=1e-9)
    assert 0.01 < sigma[0] < 0.2
    x, y = differences(entries, _BY_NAME["projector_principal_point_px"])
    assert x[0].tolist() == [0.0] * len(entries)
    assert np.all(np.diff(y[0]) > 0)
    assert 1.4 < y[0][-1] < 1.5
    turned = np.linalg.norm([values for values, _ in differences(entries, _BY_NAME["rotation_deg"])], axis=0)
    assert 0.045 < turned[-1] < 0.055


def test_angles_do_not_jump_by_a_turn_and_what_is_unknown_is_left_out() -> None:
    first, second = (entry for _, entry in drifting(2))
    first = first.model_copy(update={"values": {**first.values, "direction_deg": [179.9, 1.0]}, "sigmas": {}})
    second = second.model_copy(update={"values": {"direction_deg": [-179.9, 1.0]}})
    (across, sigma), _ = differences([first, second], _BY_NAME["direction_deg"])
    assert across[1] == pytest.approx(0.2)
    assert sigma[0] == 0.0
    ((focal, _),) = differences([first, second], _BY_NAME["camera_focal_px"])
    assert focal[0] == 0.0
    assert np.isnan(focal[1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nothing", "expected a list of calibrations over time"),
        ("- {values: {}}", "0.date: Field required"),
        ("- {date: '2026-05-04T09:00:00', values: {}}", "timezone"),
        ("- {date: '2026-05-04T09:00:00Z', values: {camera_focal_px: [.nan]}}", "camera_focal_px"),
        ("- {date: [", "not valid YAML"),
    ],
)
def test_what_is_no_log_is_said(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "rig.log.yaml").write_text(text)
    with pytest.raises(InputError, match=r"rig\.log\.yaml") as refused:
        read_log(tmp_path / "rig.log.yaml")
    assert words in str(refused.value)
