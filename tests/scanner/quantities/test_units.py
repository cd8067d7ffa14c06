"""Lengths on the command line have a unit, and limits on both sides."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.errors import InputError
from scanner.quantities import parse_length, shown_unit
from tests.support.command_line import run


@given(length_m=st.floats(1e-6, 1e4), unit=st.sampled_from([("m", 1.0), ("mm", 1e-3), ("in", 0.0254)]))
def test_a_length_keeps_its_value_in_another_unit(length_m: float, unit: tuple[str, float]) -> None:
    name, metres = unit
    number = max(length_m, 2e-6) / 1.001 / metres
    assert parse_length(f"{number!r}{name}", "m") == pytest.approx(number * metres)


@pytest.mark.parametrize("unit", ["m", "baseline"])
@pytest.mark.parametrize(
    "text", ["1e308m", "1e30m", "1e5m", "1e-300m", "1e-9mm", "1e308", "1e-300", "1e999", "1e400mm"]
)
def test_a_length_that_nothing_has_is_refused(text: str, unit: str) -> None:
    with pytest.raises(InputError, match="expected a length"):
        parse_length(text, unit)


@pytest.mark.parametrize("value", ["1e-300", "1e-7", "20000", "1e300"])
def test_a_scale_that_nothing_has_is_refused(value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--config", "configs/room-sim.yaml", "--set", f"scale.baseline_m={value}", "--out", "none") == 2
    assert "'scale.baseline_m' must be" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("unit", "words"),
    [("m", "50.8 ± 1.2 mm"), ("cm", "0.508 ± 0.012 mm"), ("mm", "0.0508 ± 0.0012 mm"), ("in", "0.0508 ± 0.0012 in")],
)
def test_metric_lengths_are_shown_in_millimetres(unit: str, words: str) -> None:
    assert shown_unit(unit).length(0.0508, 0.0012) == words


@pytest.mark.parametrize("text", ["0.1 mm", "0.05 mm", "0.254 mm", "25 mm"])
@pytest.mark.parametrize("working", ["m", "mm"])
def test_a_stated_length_is_shown_with_its_own_digits(text: str, working: str) -> None:
    assert shown_unit(working).stated(parse_length(text.replace(" ", ""), working)) == text
