from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Size
from calib.self_calibration import PrincipalPoint
from hw.settings import SimulatedRigSettings
from scanner.configuration.schema import Config, load_config
from scanner.errors import InputError
from scanner.io import known_keys
from scanner.patterns import sequence_for
from scanner.results import provenance
from tests.support.places import ROOT

ROOM_SIM = ROOT / "configs" / "room-sim.yaml"
SIZES = {"camera": {"width": 640, "height": 480}, "projector": {"width": 320, "height": 240}}


def load(tmp_path: Path, text: str, *overrides: str) -> Config:
    path = tmp_path / "room.yaml"
    path.write_text(text)
    return load_config(path, overrides)


def test_the_default_room_is_the_rig_of_the_paper_at_half_resolution() -> None:
    config = load_config(ROOM_SIM)
    assert config.required_rig.backend == "simulated"
    assert config.camera_size == (1224, 1024)
    assert config.projector_size == (854, 480)
    assert config.principal_point(config.camera_size).px == (611.5, 511.5)
    assert config.principal_point(config.camera_size).sigma_px == 35
    assert config.sequence.patterns((854, 480)) == sequence_for((854, 480))


def test_without_a_configuration_the_principal_point_is_near_the_centre() -> None:
    point = load_config(None).principal_point(Size(1000, 500))
    assert point.px == (499.5, 249.5)
    assert point.sigma_px == 30


def test_a_prior_has_the_given_sigma(tmp_path: Path) -> None:
    config = load(tmp_path, "camera: {principal_point: {prior: centre, sigma_px: 70}}")
    assert config.principal_point(Size(1000, 500)).sigma_px == 70


def test_nothing_is_known_of_a_projectors_principal_point_unless_it_is_said(tmp_path: Path) -> None:
    size = Size(1000, 500)
    assert load_config(None).projector_point(size) is None
    prior = load(tmp_path, "projector: {principal_point: {prior: centre}}").projector_point(size)
    assert prior == PrincipalPoint((499.5, 249.5), 30.0)
    known = load(tmp_path, "projector: {principal_point: {known: [500, 520]}}").projector_point(size)
    assert known == PrincipalPoint((500.0, 520.0), 0.0)


def test_a_projectors_principal_point_is_in_square_pixels(tmp_path: Path) -> None:
    own = "width: 912, height: 1140, pixel_aspect: 0.5, principal_point: {known: [900, 1100]}"
    config = load(tmp_path, f"projector: {{{own}}}")
    assert config.projector_point(config.projector_size) == PrincipalPoint((900.0, 1100.0), 0.0)
    with pytest.raises(InputError, match=r"projector is 1824 × 1140, but the images are 912 × 1140: projector\.princ"):
        config.projector_point(Size(912, 1140))


def test_keys_of_the_sequence_override_its_preset(tmp_path: Path) -> None:
    config = load(tmp_path, "sequence: {preset: quick, shifts: 3, inverses: true}")
    assert config.sequence.patterns((64, 48)) == sequence_for((64, 48), inverses=True, periods=(12.3,), shifts=3)


@pytest.mark.parametrize(("preset", "frames"), [("quick", 23), ("standard", 44), ("concave", 42)])
def test_the_presets_have_as_many_frames_as_the_documentation_says(preset: str, frames: int) -> None:
    patterns = load_config(None, [f"sequence.preset={preset}"]).sequence.patterns((854, 480))
    assert len(patterns) == frames == len(set(patterns))


def test_exposures_are_kept_in_their_order(tmp_path: Path) -> None:
    assert load(tmp_path, "sequence: {exposures_us: [8000.0, 500]}").sequence.exposures_us == (8000.0, 500.0)


def test_overrides_reach_every_depth_and_are_yaml(tmp_path: Path) -> None:
    config = load(
        tmp_path,
        "method: paper",
        "method=refined",
        "rig.seed=7",
        "camera.principal_point={known: [10, 20.5]}",
        "scale.baseline_m=4e-1",
        "corner.same=false",
    )
    assert config.method == "refined"
    assert isinstance(config.required_rig, SimulatedRigSettings)
    assert config.required_rig.seed == 7
    assert config.camera.principal_point.known == (10, 20.5)
    assert config.scale is not None
    assert config.scale.baseline_m == 0.4
    assert config.corner.same is False


def test_passwords_of_cameras_are_recorded_nowhere(tmp_path: Path) -> None:
    config = load(tmp_path, "rig: {backend: opencv, camera: 'http://anna:s%40cr:t@10.0.0.9:8080/video?a=b@c'}")
    assert config.recorded["rig"]["camera"] == "http://anna@10.0.0.9:8080/video?a=b@c"
    settings = provenance(tmp_path, config).configuration
    assert "s%40cr" not in str(settings)
    assert "anna" in str(settings)


def test_earlier_results_are_beside_the_configuration(tmp_path: Path) -> None:
    config = load(tmp_path, "earlier: [scans/one, /elsewhere/two]")
    assert config.earlier == (tmp_path / "scans/one", Path("/elsewhere/two"))
    assert load(tmp_path, "earlier: [scans/one]", "earlier=[]").earlier == ()
    assert load_config(None, ["earlier=[one]"]).earlier == (Path("one"),)


@pytest.mark.parametrize(
    ("given", "metres"), [("0.52", 0.52), ("520mm", 0.52), ("52 cm", 0.52), ("520m", 520.0), ("2mm", 0.002)]
)
def test_lengths_take_units_and_are_read_again(tmp_path: Path, given: str, metres: float) -> None:
    config = load(tmp_path, f"scale: {{baseline_m: {given}}}")
    assert config.scale is not None
    assert config.scale.baseline_m == pytest.approx(metres, rel=1e-12)
    assert type(config.scale).model_validate(config.scale.model_dump()) == config.scale


def test_an_override_can_remove_a_section(tmp_path: Path) -> None:
    assert load(tmp_path, "scale: {baseline_m: 1}", "scale=null").scale is None


def test_every_key_is_described() -> None:
    schema = Config.model_json_schema()
    for model in (schema, *schema["$defs"].values()):
        for name, field in model["properties"].items():
            assert field.get("description") or "const" in field, name


@dataclass(frozen=True)
class Wrong:
    """A configuration, and words of the expected message."""

    text: str
    words: tuple[str, ...]


WRONG = [
    Wrong("camera: {widht: 640}", ("'camera.widht'", "'camera.width'")),
    Wrong("camer: {width: 640}", ("'camer'", "'camera'")),
    Wrong("rig: {walls_of_deg: 1}", ("'rig.walls_of_deg'", "'rig.walls_off_deg'")),
    Wrong("walls_off_deg: 1", ("'rig.walls_off_deg'",)),
    Wrong("camera: {principle_point: {prior: centre}}", ("'camera.principal_point'",)),
    Wrong("xyzzy: 1", ("'xyzzy'", "camera, projector")),
    Wrong("camera: 5", ("'camera'", "section", "5")),
    Wrong("camera:", ("'camera'", "section", "None")),
    Wrong("camera: {width: 640}", ("'camera'", "both width and height")),
    Wrong("camera: {width: -640, height: 480}", ("'camera.width'", "16", "-640")),
    Wrong("camera: {width: 640.5, height: 480}", ("'camera.width'", "integer", "640.5")),
    Wrong("camera: {width: '640', height: 480}", ("'camera.width'", "integer", "'640'")),
    Wrong("camera: {width: true, height: 480}", ("'camera.width'", "integer", "True")),
    Wrong("camera: {width: 1e9, height: 480}", ("'camera.width'",)),
    Wrong("camera: {principal_point: {known: [1]}}", ("'camera.principal_point.known[1]'", "missing")),
    Wrong("camera: {principal_point: {known: [1, 2, 3]}}", ("'camera.principal_point.known'", "at most 2")),
    Wrong("camera: {principal_point: {known: [1, .nan]}}", ("known[1]", "finite", "nan")),
    Wrong("camera: {principal_point: {known: [1, 2], prior: centre}}", ("known", "prior", "not both")),
    Wrong("camera: {principal_point: {prior: corner}}", ("'centre'", "'corner'")),
    Wrong("camera: {principal_point: {prior: centre, sigma_px: 0}}", ("sigma_px", "greater than 0")),
    Wrong("camera: {principal_point: centre}", ("'camera.principal_point'", "section", "'centre'")),
    Wrong("projector: {principal_point: {known: [1, 2], sigma_px: 3}}", ("known", "sigma_px", "not both")),
    Wrong("projector: {principal_point: {sigma_px: -3}}", ("'projector.principal_point.sigma_px'", "-3")),
    Wrong("lens: {radial: -1}", ("'lens.radial'", "-1")),
    Wrong("lens: {radial: 0, from: a.yaml}", ("radial", "from", "not both")),
    Wrong("rig: {backend: webcam}", ("'rig.backend'", "'simulated'", "'webcam'")),
    Wrong("sequence: {preset: slow}", ("'sequence.preset'", "'standard', 'quick' or 'concave'", "'slow'")),
    Wrong("sequence: {shifts: 2}", ("shifts", "3 or more", "2")),
    Wrong("sequence: {cell: 32}", ("cell (32)", "period (16.0)")),
    Wrong("sequence: {periods: [.inf]}", ("'sequence.periods[0]'", "finite")),
    Wrong("sequence: {periods: [8.0, 8.0]}", ("periods must differ", "8, 8")),
    Wrong("sequence: {exposures_us: [1000.0]}", ("exposures_us", "two or more")),
    Wrong("sequence: {exposures_us: [1000.0, 1000.0]}", ("exposures_us", "differ")),
    Wrong("sequence: {exposures_us: [1000.0, -5.0]}", ("'sequence.exposures_us[1]'", "-5")),
    Wrong("sequence: {inverses: maybe}", ("'sequence.inverses'", "boolean", "'maybe'")),
    Wrong("method: best", ("'method'", "'refined' or 'paper'", "'best'")),
    Wrong("corner: {squareness_deg: -1}", ("'corner.squareness_deg'", "-1")),
    Wrong("earlier: [3]", ("'earlier[0]'", "3")),
    Wrong("earlier: scans/one", ("'earlier' must be a list", "'scans/one'")),
    Wrong("scale: {baseline_m: 0}", ("'scale.baseline_m'", "greater than or equal to 0.000001")),
    Wrong("scale: {baseline_m: 520}", ("'scale.baseline_m'", "520mm for millimetres", "520m if it is so")),
    Wrong("scale: {baseline_m: 0.5 ells}", ("'scale.baseline_m'", "'ells' is not known")),
    Wrong("scale: {baseline_m: 1, camera_to_corner_m: 2}", ("'scale'", "not both")),
    Wrong("method: paper\nmethod: refined", ("line 2", "'method'", "twice")),
    Wrong("camera: {width: 640, width: 320, height: 480}", ("line 1", "'width'", "twice")),
    Wrong("camera: {width: 640", ("line 1", "YAML")),
    Wrong("method: !!python/object/apply:os.system [ls]", ("line 1", "tag")),
    Wrong("a: \x07", ("YAML", "special characters")),
    Wrong("[" * 5000, ("nested too deeply",)),
    Wrong("method: 2026-13-45", ("YAML", "month")),
    Wrong("a: &a [x, x]\nb: *c", ("line 2", "alias")),
    Wrong("- method", ("found a list",)),
    Wrong("just words", ("found a str",)),
    Wrong("1: 2", ("[1]", "strings")),
]


@pytest.mark.parametrize("case", WRONG, ids=lambda case: case.text[:40])
def test_a_wrong_configuration_is_refused(tmp_path: Path, case: Wrong) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, case.text)
    for word in ("room.yaml", *case.words):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("camera.width", ("KEY=VALUE",)),
        ("=640", ("KEY=VALUE",)),
        ("camera..width=640", ("KEY=VALUE",)),
        ("camera.width=[640", ("--set camera.width", "YAML")),
        ("camera.width.px=640", ("'width'", "not a section")),
        ("camera.wdth=640", ("'camera.wdth'", "'camera.width'")),
    ],
)
def test_a_wrong_override_is_refused(tmp_path: Path, override: str, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, yaml.safe_dump(SIZES), override)
    for word in words:
        assert word in str(caught.value)


def test_all_wrong_keys_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, "methid: paper\ncamera: {widht: 1}\nscale: {baseline_m: -1}")
    assert len(str(caught.value).splitlines()) == 3


@pytest.mark.parametrize("name", ["missing.yaml", "."])
def test_a_missing_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"no such file|is a folder"):
        load_config(tmp_path / name)


def test_a_huge_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too large: expected no more than 1 MB, found 5 MB"):
        load(tmp_path, "#" * 5_000_000)


def test_missing_keys_of_a_command_are_named() -> None:
    config = load_config(None)
    for ask, words in (
        (lambda: config.required_rig, "'rig'"),
        (lambda: config.camera_size, "'camera.width'"),
        (lambda: config.projector_size, "'projector.width'"),
    ):
        with pytest.raises(InputError, match=words):
            ask()


@pytest.mark.parametrize(
    ("size", "words"), [(Size(1224, 1024), "640 × 480.*1224 × 1024.*does not apply"), (Size(640, 480), "far outside")]
)
def test_a_known_principal_point_must_fit_the_images(tmp_path: Path, size: Size, words: str) -> None:
    config = load(tmp_path, "camera: {width: 640, height: 480, principal_point: {known: [5000, 240]}}")
    with pytest.raises(InputError, match=words):
        config.principal_point(size)


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "rig": st.fixed_dictionaries({"backend": st.just("simulated"), "seed": st.integers(0, 1000)}),
            "projector": st.fixed_dictionaries({"width": st.integers(16, 9999), "height": st.integers(16, 9999)}),
            "method": st.sampled_from(["refined", "paper"]),
            "corner": st.fixed_dictionaries({"squareness_deg": st.floats(0, 10), "same": st.booleans()}),
            "scale": st.fixed_dictionaries({"baseline_m": st.floats(0.005, 20)}),
            "sequence": st.fixed_dictionaries(
                {
                    "periods": st.lists(st.floats(8, 64), min_size=1, max_size=3, unique=True),
                    "shifts": st.integers(3, 16),
                }
            ),
        },
    )
)
def test_configurations_read_back_the_same(tmp_path_factory: pytest.TempPathFactory, settings: dict[str, Any]) -> None:
    path = tmp_path_factory.getbasetemp() / "written.yaml"
    path.write_text(yaml.safe_dump(settings))
    read = load_config(path)
    assert read.model_dump(mode="json", exclude_unset=True) == settings
    path.write_text(yaml.safe_dump(read.model_dump(mode="json", by_alias=True)))
    assert load_config(path) == read


def test_known_keys_are_dotted_paths() -> None:
    keys = set(known_keys(Config))
    assert {"camera", "camera.width", "camera.principal_point.known", "rig.seed", "scale.baseline_m"} <= keys
