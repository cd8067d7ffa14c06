"""`scan compare` with clouds and meshes: aligned without a first guess, with deviations and their sigmas."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.deferred_imports import open3d
from calib.registration import Alignment, SurfaceRegistration
from scanner.commands import compare
from scanner.comparing import Conformity, SurfaceComparison, compare_surfaces
from scanner.exporting import FORMATS, ExportRequest
from scanner.io import read_surface
from tests.support.blob import Blob
from tests.support.command_line import names, run
from tests.support.result_folder import write_result
from tests.support.surface_files import write_cloud, write_mesh

pytestmark = pytest.mark.xdist_group("comparing surfaces")  # what the module shares is made once
DENT = 0.2
FILES = {"compare.json", "compare.html", "deviation.ply", "reference.ply"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The CAD model, a sound part and one with a dent."""
    folder = tmp_path_factory.mktemp("parts")
    write_mesh(folder / "cad.stl", Blob())
    write_cloud(folder / "sound.ply", *Blob().cloud(60_000, 1, (0.3, 0.1, 1)))
    write_cloud(folder / "dented.ply", *Blob(dent=DENT).cloud(60_000, 2, (0.3, 0.1, 1)), seed=1)
    return folder


@pytest.fixture
def comparisons(monkeypatch: pytest.MonkeyPatch) -> list[SurfaceComparison]:
    """What the command compares, one after the other."""
    found: list[SurfaceComparison] = []

    def kept(*arguments: Any, **named: Any) -> SurfaceComparison:
        found.append(compare_surfaces(*arguments, **named))
        return found[-1]

    monkeypatch.setattr(compare, "compare_surfaces", kept)
    return found


def test_a_dent_is_found_and_measured(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    comparisons: list[SurfaceComparison],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arguments = ("--unit", "mm", "--tolerance", "0.1mm", "--out", folder / "out")
    assert run("compare", folder / "dented.ply", folder / "cad.stl", *arguments) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "✕ Fail: a part of the surface is surely beyond" in told
    assert names(folder / "out") == {*FILES, "reference.glb"}
    document = json.loads((folder / "out" / "compare.json").read_text(encoding="utf-8"))
    (region,) = document["regions"]
    assert region["deviation"] == pytest.approx(-DENT, abs=0.05)
    assert 0.001 < region["sigma"] < 0.02
    top = Blob(dent=DENT).points(np.array([[0.0, 0.0, 1.0]]))[0]
    assert np.linalg.norm(np.array(region["centre"]) - top) < 3.0
    assert document["tolerance"]["conformity"] == "fail"
    assert 0.001 < document["tolerance"]["share_beyond"] < 0.05
    cloud = read_surface(folder / "out" / "deviation.ply")
    assert cloud.unit == "mm"
    assert len(cloud.points) == document["points"]
    on_cad = open3d().t.io.read_point_cloud(str(folder / "out" / "reference.ply")).point
    deviation, places = on_cad["deviation"].numpy()[:, 0], on_cad["positions"].numpy()
    assert np.nanmin(deviation) == pytest.approx(-DENT, abs=0.05)
    assert np.linalg.norm(places[np.nanargmin(deviation)] - top) < 3.0
    assert 0.2 < np.isfinite(deviation).mean() < 0.8  # the other side was not scanned
    mesh = open3d().io.read_triangle_mesh(str(folder / "out" / "reference.glb"))
    assert mesh.has_vertex_colors()
    page = (folder / "out" / "compare.html").read_text(encoding="utf-8")
    assert page.count("<img") == 3
    assert 'section class="verdict refused"' in page
    assert run("compare", folder / "dented.ply", folder / "cad.stl", *arguments) == 2
    monkeypatch.setattr(compare, "compare_surfaces", lambda *_, **__: comparisons[0])
    allowed = ("--unit", "mm", "--tolerance", "0.1mm", "--allow", "--quiet")
    assert run("compare", folder / "dented.ply", folder / "cad.stl", *allowed) == 0


def test_a_sound_part_passes_and_has_no_region(
    folder: Path, capsys: pytest.CaptureFixture[str], comparisons: list[SurfaceComparison]
) -> None:
    assert run("compare", folder / "sound.ply", folder / "cad.stl", "--unit", "mm", "--tolerance", "0.1mm") == 0
    told = capsys.readouterr().out
    assert "✓ Pass" in told
    assert "Region" not in told
    assert not comparisons[0].regions
    assert run("compare", folder / "sound.ply", folder / "cad.stl", "--unit", "mm", "--tolerance", "0.005mm") == 4
    assert "Not decidable with this scan" in capsys.readouterr().out
    # The sigma of a point is what it is off.
    measured = comparisons[1].measured
    assert measured is not None
    assert measured.there.mean() > 0.99
    assert 0.8 < np.std(comparisons[1].compared / measured.sigma[measured.there]) < 1.3


def test_the_unit_of_a_mesh_is_found(folder: Path) -> None:
    points, normals = Blob().cloud(40_000, 3, (0, 1, 0.4))
    cloud = folder / "metres.ply"
    write_cloud(cloud, points, normals, 1e-3, seed=2)
    text = cloud.read_bytes().replace(b"\nelement vertex", b"\ncomment unit m (of x, y, z)\nelement vertex", 1)
    cloud.write_bytes(text)
    comparison = compare_surfaces(cloud, folder / "cad.stl", tolerance="0.15mm")
    assert comparison.is_aligned
    assert comparison.unit == "mm"
    assert comparison.found_unit is not None
    assert "does not state its unit" in comparison.found_unit
    assert comparison.test is not None
    assert comparison.test.conformity is Conformity.PASS


@pytest.mark.parametrize(
    ("unit", "factor", "told"),
    [
        ("mm", 1 / 25.4, "does not state its unit: taken as 'in', as fits best."),
        (None, 1e-3, "was enlarged 1000 times, as fits best."),
    ],
)
def test_other_units_of_both_files_are_told(unit: str | None, factor: float, told: str, folder: Path) -> None:
    points, normals = Blob().cloud(20_000, 5, (0, 1, 0.4))
    write_cloud(folder / "other.ply", points, normals, factor)
    comparison = compare_surfaces(folder / "other.ply", folder / "cad.stl", unit=unit)
    assert comparison.is_aligned
    assert comparison.registration.best is not None
    assert comparison.registration.best.scale == pytest.approx(1 / factor)
    assert told in str(comparison.found_unit)


def test_other_units_are_tried_only_where_the_same_one_gives_no_pose(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = list[list[float]]()

    def register(*_: object, scales: Sequence[float], with_scale: bool) -> SurfaceRegistration:
        assert not with_scale
        tried.append([*scales])
        return SurfaceRegistration(Alignment.LOOSE, None, (), (), np.zeros(3), np.eye(6), 0.0, 0.0)

    monkeypatch.setattr("scanner.comparing.surface_comparison.register_surfaces", register)
    compare_surfaces(folder / "sound.ply", folder / "cad.stl", unit="m")
    assert tried[0] == [1.0]
    assert {0.3048, 1.0} <= set(np.round(tried[1], 6))
    assert len(tried) == 2


def test_what_turns_is_not_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    body = Blob((45, 45, 25), 0.0)
    write_mesh(folder / "wheel.obj", body)
    cloud = write_cloud(folder / "wheel.ply", *body.cloud(30_000, 4, (0.2, 0, 1)))
    assert run("compare", cloud, folder / "wheel.obj", "--out", folder / "wheel") == 4
    assert "It may turn about the axis" in " ".join(capsys.readouterr().out.split())
    assert names(folder / "wheel") == {"compare.json", "compare.html"}
    (free,) = json.loads((folder / "wheel" / "compare.json").read_text(encoding="utf-8"))["free"]
    assert free["turns"]


def test_a_result_is_compared_with_its_own_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room")
    FORMATS["stl"].write(ExportRequest(written.folder, tmp_path / "room.stl"))
    assert run("compare", written.folder, tmp_path / "room.stl", "--out", tmp_path / "out") == 0
    assert "✓ No region deviates" in capsys.readouterr().out
    assert names(tmp_path / "out") == {*FILES, "deviation.glb", "reference.glb"}
    assert run("compare", written.folder, written.folder, "--surfaces") == 0
    assert "✓ No region deviates" in capsys.readouterr().out
    assert run("compare", written.folder, written.folder) == 0
    assert "✓ The calibrations are the same." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("sound.ply", "cad.stl", "--tolerance", "0.1mm"), "neither file states its unit"),
        (("sound.ply", "cad.stl", "--unit", "ell"), "--unit: expected one of"),
        (("sound.ply", "cad.stl", "--out", "few.xyz"), "few.xyz: is a file, expected a folder to write into"),
        (("sound.ply", "cad.stl", "--depths", "1m"), "--depths is for calibrations"),
        (("sound.ply", "none.stl"), "no such file"),
        (("few.xyz", "cad.stl"), "few.xyz: expected a surface, of 24 points or more, found 4"),
        (("sound.ply", "part.iges"), "export it from the CAD program"),
        (("sound.ply", "cad.stl", "--unit", "m", "--tolerance", "x"), "--tolerance: expected a length"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    arguments: tuple[str, ...],
    told: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    Path("few.xyz").write_text("0 0 0\n90 0 0\n0 60 0\n0 0 50\n")
    Path("part.iges").write_text("S\n")
    assert run("compare", *arguments) == 2
    assert told in " ".join(capsys.readouterr().err.split())


def test_options_of_surfaces_are_not_for_calibrations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room")
    assert run("compare", written.folder, written.folder, "--tolerance", "1mm") == 2
    assert "add --surfaces" in capsys.readouterr().err
