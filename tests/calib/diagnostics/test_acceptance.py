"""Undetermined, ambiguous or non-square solutions are refused with a reason; others are accepted."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics.acceptance import missing_knowledge, no_corner, refuse_degenerate, refuse_untrustworthy
from calib.estimation import into_cells
from calib.refinement import CAMERA, PROJECTOR, Knowledge, Refinement, at_focal, family_of, refine, straighten
from calib.refusal import PHOTOS, RIG, RefusalError
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

KNOWLEDGE = Knowledge(
    (PAPER_CAMERA.width, PAPER_CAMERA.height),
    (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height),
    PAPER_CAMERA.principal_point_px,
    0.0,
    0.0,
)


@pytest.fixture(scope="module")
def good() -> Refinement:
    """A solution that is well determined."""
    capture = random_capture(np.random.default_rng(3), count=5000, distance=(1.5, 2.5))
    cells = into_cells(capture.matches)
    focals = np.geomspace(1200.0, 2700.0, 12)
    refinement = refine([cells], [family_of(cells, KNOWLEDGE)], focals, KNOWLEDGE, same=False)
    assert refinement is not None
    return refinement


def refusal_of(refinement: Refinement, knowledge: Knowledge = KNOWLEDGE) -> RefusalError:
    with pytest.raises(RefusalError) as caught:
        refuse_untrustworthy(refinement, knowledge)
    return caught.value


def with_sigma(refinement: Refinement, device: slice, sigma: float) -> Refinement:
    """Set the relative standard deviation of a device's focal length."""
    covariance = refinement.covariance.copy()
    covariance[device.start, device.start] = sigma**2
    return replace(refinement, covariance=covariance)


def test_a_good_solution_is_accepted(good: Refinement) -> None:
    refuse_untrustworthy(good, KNOWLEDGE)


@pytest.mark.parametrize(("device", "name"), [(CAMERA, "camera"), (PROJECTOR, "projector")])
def test_a_focal_length_is_refused_only_beyond_the_largest_useful_sigma(
    good: Refinement, device: slice, name: str
) -> None:
    refuse_untrustworthy(with_sigma(good, device, 0.149), KNOWLEDGE)
    refusal = refusal_of(with_sigma(good, device, 0.171))
    assert f"hardly determines the {name}'s focal length: its sigma is 17 %" in refusal.reason
    assert "also helps" not in refusal.advice  # both are known
    refusal_of(with_sigma(good, device, np.nan))


@pytest.mark.parametrize(
    ("centre_px", "squareness_deg", "offered"),
    [
        (30.0, 0.0, "A principal point that is known also helps."),
        (0.0, 0.3, "A corner that is known to be square also helps."),
        (0.0, 0.0, ""),
        (30.0, 0.3, "A principal point that is known, or a corner that is known to be square, also helps."),
    ],
)
def test_the_advice_names_missing_knowledge(centre_px: float, squareness_deg: float, offered: str) -> None:
    knowledge = replace(KNOWLEDGE, principal_point_sigma_px=centre_px, squareness_deg=squareness_deg)
    assert missing_knowledge(knowledge).strip() == offered


def with_other(refinement: Refinement, focal_factor: float, extra_cost: float) -> Refinement:
    fit = refinement.fit
    other = replace(fit, state=at_focal(fit.state, focal_factor * fit.state.camera[0]), cost=fit.cost + extra_cost)
    return replace(refinement, others=(other,))


def test_two_solutions_are_ambiguous_if_both_fit_and_differ(good: Refinement) -> None:
    sigma = float(np.sqrt(good.covariance[CAMERA.start, CAMERA.start]))
    assert 1e-4 < sigma < 0.02
    refusal = refusal_of(with_other(good, 1.25, 8.9))
    assert "Ambiguous" in refusal.reason
    for focal in (good.fit.state.camera[0], 1.25 * good.fit.state.camera[0]):
        assert f"focal length of {focal:.0f} px" in refusal.reason
    refuse_untrustworthy(with_other(good, 1.25, 9.1), KNOWLEDGE)  # three sigmas worse
    refuse_untrustworthy(with_other(good, np.exp(sigma), 0.1), KNOWLEDGE)  # the same, within the uncertainty
    assert "Ambiguous" in refusal_of(with_other(good, np.exp(4 * sigma), 0.1)).reason


@pytest.mark.parametrize(
    ("device", "widths", "is_plausible"),
    [
        ("camera", 0.29, False),
        ("camera", 0.31, True),
        ("camera", 3.9, True),
        ("camera", 4.1, False),
        ("projector", 0.19, False),
        ("projector", 0.21, True),
        ("projector", 9.9, True),
        ("projector", 10.1, False),
    ],
)
def test_impossible_focal_lengths_are_refused(good: Refinement, device: str, widths: float, is_plausible: bool) -> None:
    state = good.fit.state
    camera, projector = state.camera.copy(), state.projector.copy()
    if device == "camera":
        camera[0] = widths * max(KNOWLEDGE.camera_size)
    else:
        projector[0] = widths * max(KNOWLEDGE.projector_size)
    odd = replace(good, fit=replace(good.fit, state=replace(state, camera=camera, projector=projector)))
    if is_plausible:
        refuse_untrustworthy(odd, KNOWLEDGE)
    else:
        assert f"a {device} with a focal length of {widths:.2g} image widths" in refusal_of(odd).reason


def test_smooth_misfit_is_judged_by_the_noise(good: Refinement) -> None:
    (noise,) = good.noise
    for match_px, limit_px in ((0.0, 0.1), (1.0, 0.4)):
        below = replace(noise, match_px=match_px, smooth_px=0.99 * limit_px)
        refuse_untrustworthy(replace(good, noise=(below,)), KNOWLEDGE)
        above = replace(below, smooth_px=1.01 * limit_px)
        refusal = refusal_of(replace(good, noise=(above,)))
        assert f"leave less than {limit_px:.2g}" in refusal.reason
        assert "of capture" not in refusal.reason
    assert "the matches of capture 2:" in refusal_of(replace(good, noise=(below, above))).reason


def test_angles_off_the_assumed_ones_are_refused(good: Refinement) -> None:
    # χ² with three degrees of freedom exceeds 21.1 once in ten thousand times.
    refuse_untrustworthy(replace(good, tension=21.0), KNOWLEDGE)
    refusal = refusal_of(replace(good, tension=21.2))
    assert "where they should be" in refusal.reason
    assert "lower by 21" in refusal.reason
    x, y = KNOWLEDGE.principal_point_px
    assert f"({x:.0f}, {y:.0f}) was given as known." in refusal.advice
    elsewhere = refusal_of(replace(good, tension=21.2), replace(KNOWLEDGE, principal_point_px=(-5.0, y)))
    assert f"(-5, {y:.0f}) was given as known, outside of the image of 2448 × 2048 pixels." in elsewhere.advice
    unsure = refusal_of(replace(good, tension=21.2), replace(KNOWLEDGE, principal_point_sigma_px=30.0))
    assert "given as known" not in unsure.advice

    loose = replace(KNOWLEDGE, squareness_deg=0.3)
    state = replace(good.fit.state, off_square=np.radians([[1.21, 0.0, 0.0]]))
    skewed = replace(good, fit=replace(good.fit, state=state), problem=good.problem.under(loose.prior(state)))
    # Walls may be that far off; what is not known of them is in the sigmas.
    refuse_untrustworthy(skewed, loose)
    refusal = refusal_of(replace(skewed, tension=21.2), loose)
    assert "they seem to be off by B–C +1.21°, C–A 0.00°, A–B 0.00°" in refusal.reason
    assert "where 0.3 degrees were allowed for" in refusal.reason


def test_faces_of_one_plane_are_refused() -> None:
    capture = random_capture(np.random.default_rng(4), count=3000)
    matches = capture.matches
    assert matches.face is not None
    cells = into_cells(matches)
    centre = (426.5, 239.5)
    straight = straighten(cells, KNOWLEDGE.principal_point_px, centre)
    refuse_degenerate([cells], [straight], RIG)
    # The largest face, cut in two, passes for two faces.
    largest = int(np.argmax(np.bincount(matches.face)))
    is_large = matches.face == largest
    left = matches.camera_px[:, 0] < np.median(matches.camera_px[is_large, 0])
    first, second = (label for label in range(3) if label != largest)
    face = np.where(is_large, np.where(left, first, second), np.where(matches.face == first, largest, -1))
    flat = into_cells(matches.with_faces(face.astype(np.int32)))
    with pytest.raises(RefusalError, match=r"The faces of capture 2 are not those of a corner") as caught:
        refuse_degenerate([cells, flat], [straight, straighten(flat, KNOWLEDGE.principal_point_px, centre)], RIG)
    assert "camera and projector well apart" in caught.value.advice


def test_without_a_possible_focal_length_the_message_names_the_devices() -> None:
    for words in (RIG, PHOTOS):
        refusal = no_corner([], words)
        assert "not the picture of a square corner for any focal length" in refusal.reason
        assert words.move in refusal.advice
