import base64
import re
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import DeviceSigmas, Sigmas
from calib.pointcloud import Cloud
from calib.scene import BY_SCENE
from scanner.capture import CaptureMetadata
from scanner.decoding import UNCHECKED, MaskReason
from scanner.patterns import sequence_for
from scanner.quantities import Quantity, device_quantities
from scanner.reporting.contents import CaptureRow, JointCaptures, ReportInput
from scanner.reporting.page import write_report
from scanner.reporting.sections import describe_patterns, faces, mask
from scanner.reporting.verdict import verdict
from scanner.results import Decoded, GivenCalibration, GivenMatches, Provenance, Reconstructed, SelfCalibrated
from tests.support.cloud_scene import Scene, room
from tests.support.result_folder import SIZES, calibrated_report, decoding_of, refused_report

VOID = {"meta", "img", "br", "hr", "input", "link"}


class Page(HTMLParser):
    """Checks that tags close in order, and collects text, attributes and ids."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.attributes: list[tuple[str, str, str]] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data.replace("\N{NO-BREAK SPACE}", " ")

    def ids(self) -> list[str]:
        return [value for _, name, value in self.attributes if name == "id"]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room()


@pytest.fixture(scope="module")
def calibrated(scene: Scene) -> ReportInput:
    return calibrated_report(scene)


@pytest.fixture(scope="module")
def refused(scene: Scene) -> ReportInput:
    return refused_report(scene)


def _calibrated(report: ReportInput) -> SelfCalibrated:
    assert isinstance(report.outcome, Reconstructed)
    assert isinstance(report.outcome.calibrated, SelfCalibrated)
    return report.outcome.calibrated


def _parts(report: ReportInput) -> tuple[Decoded, Cloud]:
    assert isinstance(report.outcome, Reconstructed)
    return report.outcome.decoded, report.outcome.cloud


def page_of(report: ReportInput, folder: Path) -> tuple[str, Page]:
    write_report(folder / "report.html", report)
    html = (folder / "report.html").read_text(encoding="utf-8")
    return html, Page(html)


@pytest.fixture(scope="module")
def calibrated_html(calibrated: ReportInput, tmp_path_factory: pytest.TempPathFactory) -> str:
    return page_of(calibrated, tmp_path_factory.mktemp("calibrated"))[0]


@pytest.fixture(scope="module")
def refused_html(refused: ReportInput, tmp_path_factory: pytest.TempPathFactory) -> str:
    return page_of(refused, tmp_path_factory.mktemp("refused"))[0]


def test_the_report_shows_verdict_numbers_and_metadata(calibrated_html: str) -> None:
    page = Page(calibrated_html)
    for expected in (
        "Camera 408 × 342",
        "Calibrated, well enough for a first look",
        "known to ± 1.3 %",
        "0.083 projector px",
        "299.5",
        "4.0",
        "+0.5 (+0.17 %)",
        "exact",
        "face A",
        "Some frames are dark.",
        "off by +0.10 degrees",
        "33.33 ms",
        "saturated: lower the exposure",
        "Lengths are in m.",
    ):
        assert expected in page.text, expected


def test_sections_are_in_order_of_importance(calibrated_html: str) -> None:
    page = Page(calibrated_html)
    sections = [value for tag, name, value in page.attributes if (tag, name) == ("section", "id")]
    assert sections == [
        "calibration",
        "faces",
        "cloud",
        "profile",
        "flatness",
        "residuals",
        "misses",
        "capture",
        "mask",
    ]
    parts = [value for tag, name, value in page.attributes if (tag, name) == ("div", "id")]
    assert parts == ["trust", "measured", "quality", "capturing"]


def test_a_refusal_gives_reason_and_advice_and_no_numbers(refused_html: str) -> None:
    page = Page(refused_html)
    assert "Not calibrated" in page.text
    assert "The faces are not square." in page.text
    assert "Choose another corner." in page.text
    assert "focal length" not in page.text
    sections = [value for tag, name, value in page.attributes if (tag, name) == ("section", "id")]
    assert sections == ["scene", "capture", "mask"]


def test_a_given_calibration_has_no_sigmas_and_no_profile(calibrated: ReportInput, tmp_path: Path) -> None:
    decoded, cloud, unsure = *_parts(calibrated), replace(_calibrated(calibrated).calibration, sigma=Sigmas())
    given = ReportInput(Reconstructed(GivenCalibration(decoded, unsure), cloud))
    _, page = page_of(given, tmp_path)
    assert "Reconstructed with the calibration that was given" in page.text
    assert "standard deviation" not in page.text
    assert "profile" not in page.ids()


def test_a_calibration_by_what_captures_share_was_not_given(calibrated: ReportInput, tmp_path: Path) -> None:
    decoded, cloud = _parts(calibrated)
    by_scene = Finding(BY_SCENE, Severity.NOTE, "Calibrated without a corner, by 500 points.")
    joint = replace(calibrated.joint, findings=(by_scene,))
    found = Reconstructed(GivenCalibration(decoded, _calibrated(calibrated).calibration), cloud)
    _, page = page_of(replace(calibrated, outcome=found, joint=joint), tmp_path)
    assert "Found by what the captures share, without a corner." in page.text
    assert "Calibrated without a corner, by 500 points." in page.text
    assert "given" not in page.text


def test_matches_alone_make_a_report(calibrated: ReportInput, tmp_path: Path) -> None:
    decoded, cloud = _parts(calibrated)
    bare = Decoded(CaptureMetadata(*SIZES), decoded.matches, GivenMatches())
    found = Reconstructed(replace(_calibrated(calibrated), decoded=bare), cloud)
    _, page = page_of(ReportInput(found), tmp_path)
    assert "face C" in page.text
    assert "mask" not in page.ids()


@pytest.mark.parametrize("kind", ["calibrated", "refused"])
def test_the_page_loads_no_external_resources(kind: str, request: pytest.FixtureRequest) -> None:
    html = request.getfixturevalue(f"{kind}_html")
    page = Page(html)
    assert "http" not in re.sub(r"data:image/[^\"]*", "", html).replace("http-equiv", "")
    links = [(tag, value) for tag, name, value in page.attributes if name in ("src", "href", "xlink:href", "data")]
    assert links
    assert all(value.startswith(("data:image/", "#")) for _, value in links)
    assert not {tag for tag, _, _ in page.attributes} & {"link", "iframe"}
    assert len(html) < 6_000_000


def test_ids_are_unique_and_references_resolve(calibrated_html: str) -> None:
    html, page = calibrated_html, Page(calibrated_html)
    ids = page.ids()
    assert len(ids) == len(set(ids)) > 10
    referred = re.findall(r'(?:href="|url\()#([^")]+)', html)
    assert referred
    assert set(referred) <= set(ids)


def test_no_text_is_smaller_than_12_px(calibrated_html: str) -> None:
    html = calibrated_html
    css = html[html.index("<style>") : html.index("</style>")]
    assert min(float(size) for size in re.findall(r"font(?:-size)?: (\d+)px", css)) >= 12
    widths = {int(width) for width in re.findall(r'class="plot"[^>]*viewBox="0 0 (\d+) ', html)}
    assert widths == {int(width) for width in re.findall(r"min-width: (\d+)px", css)} & widths  # never drawn smaller


def test_hostile_strings_are_escaped(calibrated: ReportInput, scene: Scene, tmp_path: Path) -> None:
    hostile = "</style><script>alert(1)</script>\"'><img src=x>{{ 7 * 7 }}"
    said = Finding(FindingKind(hostile, hostile, hostile), Severity.WARNING, hostile, hostile)
    found, (decoded, cloud) = _calibrated(calibrated), _parts(calibrated)
    outcome = Reconstructed(
        SelfCalibrated(
            replace(
                decoded,
                metadata=replace(decoded.metadata, identity={hostile: hostile}),
                origin=replace(decoding_of(scene), findings=(said,)),
            ),
            replace(found.solution, findings=(said,)),
            replace(found.calibration, unit=hostile),
        ),
        replace(cloud, unit=hostile),
    )
    joint = JointCaptures(2, (CaptureRow(hostile, "", 1, None, None),))
    made = Provenance(hostile, datetime(2026, 1, 2, 3, 4, tzinfo=UTC), hostile, {"method": hostile})
    spoiled = ReportInput(outcome, files=(hostile,), joint=joint, provenance=made)
    html, page = page_of(spoiled, tmp_path)
    assert page.text.count(hostile) >= 8
    assert "2026-01-02, 03:04 UTC" in page.text
    assert "<script>alert" not in html
    assert ("img", "src", "x") not in page.attributes


def test_pictures_have_the_stated_type_and_size(calibrated_html: str) -> None:
    page = Page(calibrated_html)
    uris = [value for tag, name, value in page.attributes if (tag, name) == ("img", "src")]
    assert len(uris) == 12  # two of them for the first page on paper
    assert sum(map(len, uris[:2])) < 0.25 * sum(map(len, uris))
    for uri in uris:
        encoded = np.frombuffer(base64.b64decode(uri.partition(",")[2]), dtype=np.uint8)
        picture = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)
        assert min(picture.shape[:2]) > 100
        assert picture.std() > 5


def test_the_edges_of_the_right_corner_lie_between_the_faces(calibrated: ReportInput, scene: Scene) -> None:
    found = replace(_calibrated(calibrated), calibration=scene.calibration)
    drawn = faces(ReportInput(Reconstructed(found, _parts(calibrated)[1])))
    assert drawn is not None
    assert len(drawn.overlay.edges) == 3
    face = np.full(scene.texture.shape[:2], -1)
    column, row = scene.matches.camera_px.astype(int).T
    face[row, column] = scene.surface
    for leg, edge in enumerate(drawn.overlay.edges):
        points = np.array([[float(number) for number in point.split(",")] for point in edge.split()])
        near = {int(face[y, x]) for x, y in _around(points[20:200])} - {-1, 3}
        assert near == {0, 1, 2} - {leg}


def _around(points: np.ndarray) -> list[tuple[int, int]]:
    offsets = np.stack(np.meshgrid([-3, 0, 3], [-3, 0, 3]), -1).reshape(-1, 2)
    pixels = (np.rint(points)[:, None] + offsets).reshape(-1, 2).astype(int)
    inside = np.all((pixels >= 0) & (pixels < SIZES[0]), axis=1)
    return [(int(x), int(y)) for x, y in pixels[inside]]


def test_shares_of_the_mask_reasons(calibrated: ReportInput) -> None:
    found = mask(_parts(calibrated)[0].decoding)
    assert found is not None
    assert found.legend[0].label == "matched"
    assert sum(float(entry.share.removesuffix(" %")) for entry in found.legend) == pytest.approx(100, abs=0.2)


@pytest.mark.parametrize(
    ("share", "words"), [(0.0, "0.0 %"), (1e-5, "< 0.1 %"), (0.25, "25.0 %"), (0.99999, "> 99.9 %"), (1.0, "100.0 %")]
)
def test_rounding_never_shows_zero_for_a_small_share(scene: Scene, share: float, words: str) -> None:
    reasons = np.full((1, 100_000), MaskReason.DARK, dtype=np.uint8)
    reasons[0, : round(share * reasons.size)] = MaskReason.KEPT
    found = mask(replace(decoding_of(scene), reasons=reasons))
    assert found is not None
    assert {entry.label: entry.share for entry in found.legend}.get("matched", "0.0 %") == words


def test_every_mask_reason_has_its_own_text_and_colour(scene: Scene) -> None:
    reasons = np.array([[int(reason) for reason in MaskReason]], dtype=np.uint8)
    found = mask(replace(decoding_of(scene), reasons=reasons))
    assert found is not None
    assert (
        len({entry.colour for entry in found.legend}) == len({entry.label for entry in found.legend}) == len(MaskReason)
    )


@pytest.mark.parametrize(
    ("sigma", "grade"),
    [
        (Sigmas(DeviceSigmas((0.5, 0.5)), DeviceSigmas((2.0, 2.0))), "good"),
        (Sigmas(DeviceSigmas((0.5, 0.5)), DeviceSigmas((2.0, 40.0))), "fair"),
        (Sigmas(DeviceSigmas((0.5, 0.5))), "fair"),
        (Sigmas(), "fair"),
    ],
)
def test_the_grade_follows_the_sigmas(calibrated: ReportInput, sigma: Sigmas, grade: str) -> None:
    found = _calibrated(calibrated)
    changed = replace(found, calibration=replace(found.calibration, sigma=sigma))
    assert verdict(ReportInput(Reconstructed(changed, _parts(calibrated)[1]))).grade == grade


def test_structured_ray_residuals_are_reported(calibrated: ReportInput) -> None:
    _, cloud = _parts(calibrated)
    missing = replace(cloud, statistics=replace(cloud.statistics, calibration_px=1.5))
    found = verdict(ReportInput(Reconstructed(_calibrated(calibrated), missing)))
    assert (found.grade, "systematic errors" in found.headline) == ("fair", True)


@pytest.mark.parametrize(
    ("quantity", "value", "error"),
    [
        (Quantity("f", 895.4321, "px", 8.16, 900.0), "895.4", "−4.6"),
        (Quantity("f", 895.4321, "px", 0.0123, 895.4), "895.432", "+0.032"),
        (Quantity("f", 895.4321, "px", 160.0, 900.0), "895", "−5"),
        (Quantity("f", 1234.5678, "px", None, None), "1234.6", ""),
        (Quantity("k", -0.00001, "", 0.001, 0.0), "0.0000", "0.0000"),
        (Quantity("k", -0.05, "", None, None), "−0.05000", ""),
    ],
)
def test_numbers_show_two_digits_of_their_sigma(quantity: Quantity, value: str, error: str) -> None:
    assert quantity.shown(quantity.value) == value
    assert quantity.shown(quantity.error, signed=True) == error


def test_quantities_are_compared_with_the_truth(calibrated: ReportInput, scene: Scene) -> None:
    focal = device_quantities("camera", _calibrated(calibrated).calibration, scene.calibration)[0]
    assert focal.error == pytest.approx(0.5)
    assert focal.error_sigmas == pytest.approx(0.125)
    assert focal.error_percent == pytest.approx(100 * 0.5 / 299)


def test_patterns_are_described_in_words() -> None:
    words = describe_patterns(sequence_for((854, 480)))
    assert words.startswith(
        "white, black, 14 × Gray code along x (cell 8 px), 12 × Gray code along y (cell 8 px), "
        "4 × fringe along x (period 16 px)"
    )


def test_a_misfit_beyond_the_noise_is_not_graded_good(calibrated: ReportInput) -> None:
    """Also for a given calibration: smooth ray residuals of three times the noise are its fault."""
    decoded, cloud = _parts(calibrated)
    given = GivenCalibration(decoded, _calibrated(calibrated).calibration)
    for smooth_px, grade in ((0.05, "good"), (0.15, "good"), (0.3, "fair")):
        statistics = replace(cloud.statistics, decoder_px=0.1, calibration_px=smooth_px)
        found = verdict(ReportInput(Reconstructed(given, replace(cloud, statistics=statistics))))
        assert found.grade == grade


@pytest.mark.parametrize(
    ("findings", "grade", "said"),
    [
        ((), "good", "all patterns along x agree"),
        ((Finding(UNCHECKED, Severity.WARNING, "Nothing checks it."),), "fair", "Nothing checks it."),
    ],
)
def test_stated_match_errors_limit_the_grade_of_one_axis(
    calibrated: ReportInput, findings: tuple[Finding, ...], grade: str, said: str
) -> None:
    """With one axis, rays meet for any calibration; an unchecked fringe is graded fair at best."""
    decoded, cloud = _parts(calibrated)
    assert decoded.decoding is not None
    matches = replace(decoded.matches, sigma_px=np.full(len(decoded.matches), 0.05))
    origin = replace(decoded.decoding, only_axis="x", findings=findings)
    of_one = replace(decoded, matches=matches, origin=origin)
    given = GivenCalibration(of_one, _calibrated(calibrated).calibration)
    found = verdict(ReportInput(Reconstructed(given, cloud)))
    assert found.grade == grade
    assert any(said in reason for reason in found.reasons)
    assert [finding for finding in found.findings if str(finding) in found.reasons] == [*found.findings]
    assert found.further == ()
    assert any("state a sigma of 0.05 projector px" in reason for reason in found.reasons)


@pytest.mark.parametrize(("x", "doubtful"), [(203.0, False), (-3.0, True), (409.0, True)])
def test_a_principal_point_outside_the_image_is_reported(calibrated: ReportInput, x: float, doubtful: bool) -> None:
    own, (_, cloud) = _calibrated(calibrated), _parts(calibrated)
    sigma = Sigmas(DeviceSigmas((0.3, 0.3)), DeviceSigmas((0.8, 0.8)))
    camera = replace(own.calibration.camera, principal_point_px=(x, 170.0))
    changed = replace(own, calibration=replace(own.calibration, camera=camera, sigma=sigma))
    found = verdict(ReportInput(Reconstructed(changed, cloud)))
    assert ("outside its image" in " ".join(found.reasons)) == doubtful
    assert found.grade == ("fair" if doubtful else "good")
