"""Plots of a calibration over time: points where the numbers are, and a mark where it had not held."""

import re
from xml.etree import ElementTree

import numpy as np

from scanner.reporting.calibration_history import history_svg
from tests.support.calibration_logs import TOUCHED, drifting

_SVG = "{http://www.w3.org/2000/svg}"


def drawn(count: int) -> ElementTree.Element:
    svg = history_svg([entry for _, entry in drifting(count)])
    return ElementTree.fromstring(str(svg).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1))


def test_points_are_where_the_numbers_are() -> None:
    plots = [group for group in drawn(8) if group.tag == f"{_SVG}g"]
    assert len(plots) == 6
    (projector,) = [plot for plot in plots if "projector: focal length" in "".join(plot.itertext())]
    x, y = (np.array([float(dot.get(f"c{axis}", "")) for dot in projector.iter(f"{_SVG}circle")]) for axis in "xy")
    assert len(x) == 8
    np.testing.assert_allclose(np.diff(x), np.diff(x)[0], atol=0.15)
    assert np.ptp(y[:TOUCHED]) == 0
    assert 15 < y[0] - y[TOUCHED] < 30  # upwards
    assert "+0.5 %" in "".join(projector.itertext())


def test_where_it_had_not_held_is_marked_and_said() -> None:
    svg = drawn(8)
    titles = [title.text for title in svg.iter(f"{_SVG}title")]
    assert len(titles) == 6
    assert all(re.match("A change of the projector's focal length by 0.5 %", title or "") for title in titles)
    assert not list(drawn(TOUCHED).iter(f"{_SVG}title"))


def test_one_entry_is_drawn_and_none_is_nothing() -> None:
    assert len(list(drawn(1).iter(f"{_SVG}circle"))) == 11
    assert history_svg([]) == ""


def test_what_a_file_says_is_only_text() -> None:
    entries = [entry.model_copy(update={"holds": False, "change": "<script>"}) for _, entry in drifting(2)]
    assert "<script>" not in history_svg(entries)
    assert "&lt;script&gt;" in history_svg(entries)
