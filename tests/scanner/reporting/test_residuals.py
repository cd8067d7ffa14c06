"""The report's table of the faces: values fit beside the map, in the unit of its heading."""

import re

import pytest

from scanner.reporting.residuals import flatness
from tests.support.cloud_scene import room
from tests.support.result_folder import calibrated_report

NUMBER = r"\d+(\.\d+)?"


def test_flatness_is_in_the_unit_of_the_table_head() -> None:
    report = calibrated_report(room())  # in metres
    found, scene = flatness(report), report.scene
    assert found is not None
    assert scene is not None
    assert found.unit == "µm"
    assert [row.name for row in found.rows] == [face.name for face in scene.faces] == ["A", "B", "C"]
    for row, face in zip(found.rows, scene.faces, strict=True):
        deviation, band = row.cells
        assert re.fullmatch(f"{NUMBER} ± {NUMBER}", deviation)
        assert re.fullmatch(NUMBER, band)
        shown, sigma = (float(number) for number in deviation.split(" ± "))
        assert float(band) == pytest.approx(1e6 * face.errors.form, rel=0.01)
        assert shown == pytest.approx(1e6 * face.deviation, abs=1e5 * face.budget.sigma)
        assert sigma == pytest.approx(1e6 * face.budget.sigma, rel=0.06)
