"""The page of the paper's results: what a tiny capture measures is stored and written."""

import json
import re
from base64 import b64decode
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from paper import published
from paper.captures import Setup, captured, thinned
from paper.comparison import where_peers_are_better
from paper.experiment import Experiment, Figures, Results, run
from paper.markdown import number
from paper.methods import CONFIGURATIONS
from paper.page import EXPERIMENTS, render, write_page
from paper.plots import Axis, curves
from paper.sphere import SPHERE
from paper.tables import TABLES
from PIL import Image

from calib.geometry import Size
from tests.support.places import ROOT

pytestmark = pytest.mark.xdist_group("paper")  # what the module shares is made once

KEPT = Results(ROOT / "benchmarks" / "paper" / "results")
TABLE_2 = next(experiment for experiment in TABLES if experiment.name == "table2")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    return Setup((0,), Size(306, 256), Size(214, 120), tmp_path_factory.mktemp("captures"), quick=True)


def test_the_page_shows_the_kept_results() -> None:
    text, pictures = render(KEPT)
    stale = "docs/results.md is stale: run python benchmarks/bench_paper.py --page"
    assert (ROOT / "docs" / "results.md").read_text(encoding="utf-8") == text, stale
    for name, svg in pictures.items():
        there = (ROOT / "docs" / "images" / "results" / name).read_text(encoding="utf-8")
        assert with_plain_pixels(there) == with_plain_pixels(svg), stale


def with_plain_pixels(svg: str) -> str:
    """PNG bytes depend on the release of Pillow, so pictures are compared as pixels."""
    return re.sub(r"base64,([^\"]+)", lambda data: Image.open(BytesIO(b64decode(data[1]))).tobytes().hex(), svg)


@pytest.fixture(scope="module")
def measured(tiny: Setup, tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Results without pycolmap."""
    results = Results(tmp_path_factory.mktemp("results"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("paper.sphere.HAS_COLMAP", False)
        for experiment in (TABLE_2, SPHERE):
            run(experiment, tiny, results, only_missing=False)
    return results


def test_the_papers_objectives_need_ideal_lenses(measured: Results) -> None:
    """With ideal lenses, both of its objectives find the intrinsics of a decoded room, as in its table 2."""
    room = measured.read("table2")["room 0"]
    for sum_of_terms in (7, 8, 9):
        errors = room["lenses corrected"][sum_of_terms]
        assert 1e-4 < np.abs(errors).mean() < 2.0, CONFIGURATIONS[sum_of_terms]
        assert np.abs(room["as decoded"][sum_of_terms]).mean() > 3.0


def test_a_sample_of_the_matches_on_faces_is_drawn(tiny: Setup) -> None:
    masked = captured(tiny, 0).with_true_faces
    some = thinned(masked, 100, seed=1)
    assert len(some) == 100
    assert set(some.labels.tolist()) == {0, 1, 2}
    assert len(thinned(masked, 10**9, seed=1)) == np.count_nonzero(masked.labels >= 0)


def test_the_page_shows_measured_results_and_names_missing_ones(measured: Results, tmp_path: Path) -> None:
    write_page(tmp_path / "page.md", tmp_path / "images", measured)
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    sums = measured.read("table2")["room 0"]["lenses corrected"]
    row = next(line for line in text.splitlines() if line.startswith("| lenses corrected"))
    assert row.endswith(f"{number(float(np.abs(sums[-1]).mean()))} |")
    assert "Not measured: table1, table1-two-views, table1-many-views, table3, figure8, beyond." in text
    assert "pip install -e '.[bench]'" in text
    assert "camera 306 × 256" in text
    assert str(published.CONFIGURATIONS[5]) in text
    ball = measured.read("figure7")["room 0"]["methods"]["true calibration"]
    assert 0.005 < ball["mean_absolute_mm"] < 0.5
    assert sorted(path.name for path in (tmp_path / "images").iterdir()) == ["figure7.svg", "table2.svg"]


def test_without_results_there_is_no_page(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no results"):
        render(Results(tmp_path))


def test_parts_are_saved_one_by_one_and_measured_once(tiny: Setup, tmp_path: Path) -> None:
    begun: list[str] = []

    def measure(_: Setup, part: str) -> Figures:
        begun.append(part)
        if part == "b" and begun.count("b") == 1:
            raise KeyboardInterrupt
        return {"value": len(begun)}

    experiment, results = Experiment("parts", lambda _: ["a", "b"], measure), Results(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run(experiment, tiny, results, only_missing=True)
    run(experiment, tiny, results, only_missing=True)
    assert begun == ["a", "b", "b"]
    assert results.read("parts") == {"a": {"value": 1}, "b": {"value": 3}}
    larger = Setup((0,), Size(612, 512), tiny.projector_size, tiny.scratch, quick=True)
    run(Experiment("parts", lambda _: ["a"], measure), larger, results, only_missing=True)
    assert results.read("parts") == {"a": {"value": 4}}, "parts of another size do not belong together"


def test_only_peers_that_are_better_are_named(tmp_path: Path) -> None:
    refined = {"paper": [9.0], "paper, lenses corrected": [0.1], "refined": [0.2]}
    document = {"made_with": {}, "parts": {"room 0": {"10": refined}}}
    (tmp_path / "table3.json").write_text(json.dumps(document))
    said = where_peers_are_better(Results(tmp_path))
    assert said.count("\n") == 0
    assert "lenses corrected” errs by 0.10 %, “refined” by 0.20 %" in said
    refined["refined"] = [0.05]
    (tmp_path / "table3.json").write_text(json.dumps(document))
    assert where_peers_are_better(Results(tmp_path)).startswith("Nothing")


def test_every_experiment_has_a_place_on_the_page() -> None:
    assert {experiment.name for experiment in TABLES} | {"figure7", "figure8", "beyond"} == set(EXPERIMENTS)


def test_curves_have_gaps_at_missing_values() -> None:
    points = [(1.0, 0.5), (2.0, 0.2), (3.0, None), (4.0, 0.1), (5.0, 0.3)]
    svg = curves(
        Axis("x"), "y", {"broken <line>": points, "bound": [(1.0, 0.1), (5.0, 0.2)]}, "alt", {"bound": "bound"}
    )
    assert svg.count('<polyline class="s0"') == 3, "two pieces and the legend's sample"
    assert svg.count('<polyline class="bound"') == 2
    assert "broken &lt;line&gt;" in svg
    assert svg.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
