"""Degenerate views are named with their angles and shares, which are known here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.diagnostics.degeneracy import reasons_in_images, reasons_in_space
from calib.estimation import Cells
from calib.geometry import Pose
from calib.numerics import Floats
from calib.refinement import PlacedCorner, State, without_lens
from calib.refusal import RIG

AHEAD = np.array([0.0, 0.0, 1.0])


def state_seen(sines: Floats, distance: float, ahead_deg: float = 90.0) -> State:
    """A corner straight ahead of the camera, `distance` baselines away. The sines of its faces' slants are given (3,);
    the projector is not rotated, and is `ahead_deg` from the line to the corner.
    """
    sines = sines / np.linalg.norm(sines)
    frame = Rotation.align_vectors(AHEAD[None], sines[None])[0].as_matrix().T
    direction = np.array([np.sin(np.radians(ahead_deg)), 0.0, np.cos(np.radians(ahead_deg))])
    device = without_lens(1000.0, np.array([500.0, 400.0]))
    corner = PlacedCorner(frame, distance * AHEAD)
    return State(device, device, Pose(np.eye(3), -direction), np.zeros((1, 3)), (corner,))


def test_a_balanced_view_has_no_degeneracy() -> None:
    assert reasons_in_space(state_seen(np.ones(3), 4.0), 0, RIG) == []


@pytest.mark.parametrize(("slant_deg", "is_named"), [(5.0, True), (7.9, True), (8.1, False)])
def test_a_grazing_face_is_named_with_its_slant(slant_deg: float, is_named: bool) -> None:
    s = np.sin(np.radians(slant_deg))
    state = state_seen(np.array([np.sqrt((1 - s**2) / 2), s, np.sqrt((1 - s**2) / 2)]), 1000.0)
    found = [reason for reason in reasons_in_space(state, 0, RIG) if "slant" in reason]
    # So far away both devices see the same slants.
    assert len(found) == 2 * is_named
    for reason, device in zip(found, ("the camera", "the projector"), strict=False):
        assert f"the second face is seen at a slant of only {slant_deg:.0f}° from {device}" in reason


def test_the_slant_seen_by_the_projector_is_named_separately() -> None:
    # The corner is two baselines away and the projector at one side: it looks along (−1, 0, 2), and along the first
    # face, which is turned away from that by 3°.
    rows = np.array([[2.0, 0.0, 1.0], [-1.0, 1.2, 2.0], [-1.2, -5.0, 2.4]])
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    turned = rows @ Rotation.from_rotvec([0.0, np.radians(3), 0.0]).as_matrix().T
    state = replace(state_seen(np.ones(3), 2.0), corners=(PlacedCorner(turned, 2 * AHEAD),))
    assert reasons_in_space(state, 0, RIG) == [
        "the first face is seen at a slant of only 3° from the projector: the face passes nearly through its centre"
    ]


@pytest.mark.parametrize(("ahead_deg", "is_named"), [(4.0, True), (11.9, True), (12.1, False), (170.0, True)])
def test_a_corner_along_the_baseline_is_named_with_the_angle(ahead_deg: float, is_named: bool) -> None:
    found = reasons_in_space(state_seen(np.ones(3), 5.0, ahead_deg), 0, RIG)
    angle = min(ahead_deg, 180 - ahead_deg)
    assert [f"behind one another ({angle:.0f}° from the line" in reason for reason in found] == [True] * is_named


@pytest.mark.parametrize(("distance", "is_named"), [(50.0, True), (34.0, True), (33.0, False)])
def test_a_short_baseline_is_named_with_its_share(distance: float, is_named: bool) -> None:
    state = state_seen(np.ones(3), distance)
    share = f"camera and projector are only {100 / distance:.1f} % of the distance to the corner apart"
    assert reasons_in_space(state, 0, RIG) == [share] * is_named
    # The same in another unit, as of a further photo.
    corner = PlacedCorner(state.corners[0].frame, 2 * state.corners[0].vertex)
    in_halves = replace(state, pose=state.pose.scaled(2), corners=(corner,))
    assert reasons_in_space(in_halves, 0, RIG) == [share] * is_named


def cells_of(*faces: tuple[float, float]) -> Cells:
    """Faces with these widths and heights in pixels, 1000 pixels apart."""
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12)), axis=-1).reshape(-1, 2)
    pixels = np.concatenate([grid * size + (1000.0 * i, 0.0) for i, size in enumerate(faces)])
    one = np.ones(len(pixels))
    return Cells(pixels, pixels, np.repeat(np.arange(3, dtype=np.int32), len(grid)), one, one, 1.0, 0.0)


def test_small_and_thin_faces_are_named() -> None:
    whole = np.hypot(2800, 900)
    assert reasons_in_images(cells_of((900, 900), (800, 700), (800, 500))) == []
    small = reasons_in_images(cells_of((900, 900), (120, 160), (800, 500)))
    assert small == [f"the second face is small: {100 * 200 / whole:.0f} % of the picture of the corner"]
    (thin,) = reasons_in_images(cells_of((900, 900), (800, 700), (800, 60)))
    assert thin.startswith("the third face is seen as a line")
    assert reasons_in_images(cells_of((900, 900), (800, 700), (800, 120))) == []
