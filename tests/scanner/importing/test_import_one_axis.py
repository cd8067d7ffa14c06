"""Stripes along one axis: without a second axis, adjacent cells determine the order."""

from itertools import product
from pathlib import Path

import pytest

from scanner.capture import open_capture
from scanner.importing import describe_order
from scanner.patterns import Axis, Pattern, xor_sequence
from tests.support.foreign_captures import AXES, ENDS, KNOWN, Photographer, bits, imported, named

pytestmark = pytest.mark.xdist_group("importing")

NUMBER: dict[Axis, int] = {"x": 10, "y": 9}


def in_order(axis: Axis, inverses: str, *, finest_first: bool) -> list[Pattern]:
    pairs = bits(axis, NUMBER[axis])
    shown, inverted = pairs[::2], pairs[1::2]
    if finest_first:
        shown, inverted = shown[::-1], inverted[::-1]
    if inverses == "after":
        return [one for pair in zip(shown, inverted, strict=True) for one in pair]
    return [*ENDS, *shown, *(inverted if inverses == "last" else [])]


@pytest.mark.parametrize(
    ("axis", "inverses", "finest_first"),
    [*product(["x"], ["last", "none"], [False, True]), ("x", "after", True), ("y", "none", True)],
)
def test_the_order_of_one_axis_is_the_only_one_that_fits(
    camera: Photographer, tmp_path: Path, axis: Axis, inverses: str, finest_first: bool
) -> None:
    patterns = in_order(axis, inverses, finest_first=finest_first)
    source = camera.write(tmp_path / "frames", patterns, named("{}.png"))
    # Twenty frames may be fringes as well, in hundreds of orders.
    layout = ("--from", "gray") if inverses == "after" else ()
    assert imported(source, *KNOWN, *layout, "--out", tmp_path / "out") == 0
    assert list(open_capture(tmp_path / "out").patterns) == patterns


# Among all orders, or among those of Gray codes alone, which is one way through the same test.
@pytest.mark.parametrize(("above_finest", "options"), [(0, ()), (3, ("--from", "gray"))])
def test_an_xor_code_is_distinguished_from_a_gray_code(
    camera: Photographer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    above_finest: int,
    options: tuple[str, ...],
) -> None:
    patterns = [*ENDS, *xor_sequence("x", AXES[0][1], 1, inverses=False, above_finest=above_finest)]
    source = camera.write(tmp_path / "frames", patterns, named("{}.png"))
    assert imported(source, *KNOWN, *options, "--out", tmp_path / "out") == 2
    assert "pixels beside each other that differ in bit" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_projector_size_must_be_given(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = camera.write(tmp_path / "frames", in_order("x", "none", finest_first=True), named("{}.png"))
    assert imported(source) == 2
    error = capsys.readouterr().err
    assert "looks right along x, but one axis does not determine the projector's size: give --projector" in error
    assert "mirrored" not in error


def test_the_descriptions_of_orders_differ() -> None:
    orders = [
        in_order("x", inverses, finest_first=fine) for inverses in ("after", "last", "none") for fine in (False, True)
    ]
    orders += [[*bits("x", 10), *bits("y", 9), *ENDS], [*ENDS, *bits("y", 9), *bits("x", 10)]]
    assert len({describe_order(order) for order in orders}) == len(orders)
    assert describe_order(orders[1]) == "x; finest bit first; each bit's inverse after it; no white or black"
    assert (
        describe_order(orders[-1]) == "y, then x; coarsest bit first; each bit's inverse after it; white, black first"
    )
