"""Stations whose rig changed so little that only all planes together reveal it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.estimation import Cells, Shifts, association_scores
from calib.geometry import PER_POSE, Pose
from calib.numerics import CUBIC, Floats, monomials
from calib.refinement import CAMERA, PROJECTOR, SHARED, TANGENTIAL
from calib.refusal import RefusalError
from calib.rooms import RigPrior, Room, changed_extrinsics, estimate_room
from calib.synthetic import RoomOptions
from tests.calib.rooms.conftest import STATIONS, Case, case_of
from tests.support.known_rigs import cells_of

ROOMS = 3


def deviations(case: Case) -> Floats:
    """(Estimate − truth) in sigmas, (size,); NaN for fixed or unobserved parameters."""
    variance = np.diag(case.found.covariance)
    return case.found.room.step_to(case.truth) / np.sqrt(np.where(variance > 0, variance, np.nan))


def millimetres(case: Case, room: Room) -> float:
    """Root mean square error of the positions."""
    apart = [a.translation - b.translation for a, b in zip(room.places[1:], case.truth.places[1:], strict=True)]
    return 1000 * case.made.calibration.baseline * float(np.sqrt(np.mean(np.sum(np.square(apart), axis=1))))


def test_errors_match_their_sigmas() -> None:
    cases = [case_of(seed) for seed in range(10, 10 + ROOMS)]
    off = [deviations(case) for case in cases]
    places = slice(SHARED + PER_POSE, SHARED + PER_POSE * STATIONS)
    for part in (slice(0, SHARED), places, slice(places.stop, None)):
        assert 0.6 < np.sqrt(np.nanmean(np.concatenate([each[part] for each in off]) ** 2)) < 1.4
    assert all(case.found.residual_px.min() > 0.005 and case.found.residual_px.max() < 0.1 for case in cases)


def test_lens_distortion_is_estimated(case: Case) -> None:
    options = RoomOptions()
    camera, projector = (
        replace(device, distortion=(*device.distortion[:2], *terms, 0.0))
        for device, terms in ((options.camera, (5e-4, -3e-4)), (options.projector, (-4e-4, 4e-4)))
    )
    bent = case_of(10, camera=camera, projector=projector)
    off = deviations(bent)
    tangential = [device.start + term for device in (CAMERA, PROJECTOR) for term in TANGENTIAL]
    assert np.all(np.abs(off[tangential]) < 4)
    assert np.abs(bent.found.room.rig.camera[5:7]).min() > 1e-4
    focals = [CAMERA.start, PROJECTOR.start]
    assert 0 < np.abs(bent.found.room.step_to(bent.truth)[focals]).max() < 2e-3
    # Of centred lenses it finds none, and is no surer of it than the matches make it.
    variance = np.diag(case.found.covariance)[tangential]
    assert np.all(variance > 0)
    assert np.all(np.abs(deviations(case)[tangential]) < 4)


def test_a_distant_start_converges_to_the_same_estimate(case: Case) -> None:
    assert 10 < millimetres(case, case.start) < 100
    from_truth = estimate_room(
        case.cells,
        case.plane_of,
        case.truth.places,
        case.truth.planes,
        case.truth.rig,
        RigPrior.from_knowledge(case.knowledge, case.truth.rig),
    )
    sigma = np.sqrt(np.nan_to_num(np.diag(case.found.covariance)))
    assert np.all(np.abs(case.found.room.step_to(from_truth.room)) <= 0.1 * sigma + 1e-9)


def test_fixing_the_true_rig_reduces_pose_sigmas(case: Case) -> None:
    found = estimate_room(
        case.cells,
        case.plane_of,
        case.start.places,
        case.start.planes,
        case.truth.rig,
        RigPrior.exactly(case.truth.rig),
    )
    assert np.all(found.rig_covariance == 0)
    assert found.room.rig.camera == pytest.approx(case.truth.rig.camera)
    for station in range(1, STATIONS):
        surer, before = (np.trace(each.place_covariance(station)) for each in (found, case.found))
        assert 0 < surer < before


def test_a_station_that_sees_two_directions_is_underdetermined_and_named(case: Case) -> None:
    """Station 1 sees only the floor with planes parallel to it, and one wall."""
    normals = np.stack([plane.normal for plane in case.truth.planes])
    shared = [plane for plane in case.plane_of[1] if 0 in case.found.stations_of[plane]]
    first, second = min(
        ((a, b) for a in shared for b in shared if a < b), key=lambda pair: abs(normals[pair[0]] @ normals[pair[1]])
    )
    along = np.cross(normals[first], normals[second])
    along /= np.linalg.norm(along)
    fewer = list(case.plane_of)
    fewer[1] = tuple(plane if plane in (first, second) else -1 for plane in fewer[1])
    found = case.estimate(fewer)
    (open_one,) = (each for each in found.undetermined if each.station == 1)
    assert not open_one.turning
    assert abs(open_one.direction @ along) > 0.999
    assert open_one.sigma > 0.5 * found.reach
    apart = found.room.places[1].translation - case.truth.places[1].translation
    across = apart - (apart @ along) * along
    assert np.linalg.norm(across) * case.made.calibration.baseline < 0.01  # the rest is held


def test_the_registration_constrains_an_underdetermined_station(case: Case) -> None:
    sigma = 0.01
    alone = [tuple(-1 for _ in planes) if station == 3 else planes for station, planes in enumerate(case.plane_of)]
    found = estimate_room(
        case.cells,
        alone,
        case.start.places,
        case.start.planes,
        case.start.rig,
        RigPrior.from_knowledge(case.knowledge, case.start.rig),
        place_sigma=(np.radians(0.1), sigma),
    )
    assert not [each for each in found.undetermined if each.station == 3]
    assert np.diag(found.place_covariance(3))[3:] == pytest.approx(sigma**2)
    assert np.allclose(found.room.places[3].translation, case.start.places[3].translation)


def test_stations_and_planes_without_cells_are_reported_as_unknown(case: Case) -> None:
    unseen = [tuple(-1 for _ in case.plane_of[0]), *case.plane_of[1:]]
    unseen[0], unseen[3] = case.plane_of[0], tuple(-1 for _ in case.plane_of[3])
    found = case.estimate(unseen)
    lost = [i for i, stations in enumerate(found.stations_of) if not stations]
    of_lost = [each for each in found.undetermined if each.station == 3]
    assert [each.turning for each in of_lost] == [True] * 3 + [False] * 3
    assert np.isnan(found.residual_px[3])
    for plane in range(len(case.truth.planes)):
        columns = case.truth.plane_columns(plane)
        assert np.isnan(found.covariance[columns, columns]).all() == (plane in lost)


def test_an_observation_of_another_plane_gets_its_own_plane(case: Case) -> None:
    """One station takes a box 4 cm in front of the wall for the wall."""
    found, truth = case.found, case.truth
    _, freedom = association_scores(found.problem, found.fit)
    tied = [each for each, ties in zip(found.patches, freedom, strict=True) if ties == 3 and each.station > 0]
    patch = max(tied, key=lambda each: len(each.cells))
    station, plane = patch.station, patch.plane
    nearer = replace(truth.planes[plane], offset=truth.planes[plane].offset + 0.04 / case.made.calibration.baseline)
    with_box = replace(truth, planes=(*truth.planes[:plane], nearer, *truth.planes[plane + 1 :]))
    shift = patch.predict(with_box)[0] - patch.predict(truth)[0]
    cells = list(case.cells)
    projector_px = cells[station].projector_px.copy()
    projector_px[cells[station].plane == case.plane_of[station].index(plane)] += shift
    cells[station] = replace(cells[station], projector_px=projector_px)
    found = replace(case, cells=cells).estimate()
    (apart,) = (each for each in found.patches if each.plane >= len(truth.planes))
    assert apart.station == station
    assert station not in found.stations_of[plane]
    step = found.room.places[station].translation - truth.places[station].translation
    sigma = np.sqrt(np.linalg.eigvalsh(found.place_covariance(station)[3:, 3:])[-1])
    assert np.linalg.norm(step) < 4 * sigma


def test_uneven_walls_widen_sigmas() -> None:
    flat, wavy = case_of(3, stations=3), case_of(3, stations=3, wavy=0.002)
    assert np.count_nonzero(flat.found.waves) <= 1
    assert np.count_nonzero(wavy.found.waves) >= 2
    heights_m = wavy.found.waves[wavy.found.waves > 0] * wavy.made.calibration.baseline
    assert 0.0003 < np.median(heights_m) < 0.01
    assert 0.2 < np.sqrt(np.nanmean(deviations(wavy)[SHARED:] ** 2)) < 2.0


def test_an_unmodelled_smooth_error_is_common_to_all_stations(case: Case) -> None:
    """A wave over the image, across the nearly horizontal epipolar lines."""

    def shifted(cells: Cells) -> Cells:
        wave = 0.3 * np.sin(cells.camera_px[:, 0] / 120.0) * np.cos(cells.camera_px[:, 1] / 150.0)
        return replace(cells, projector_px=cells.projector_px + np.stack([np.zeros_like(wave), wave], axis=1))

    odd = replace(case, found=replace(case, cells=[shifted(cells) for cells in case.cells]).estimate())
    assert case.found.levels.alike < 1.3
    assert 2 < odd.found.levels.alike <= STATIONS
    assert np.abs(deviations(odd)[[CAMERA.start, PROJECTOR.start]]).max() < 4


def test_smooth_errors_of_the_decoder_add_to_the_covariance(case: Case) -> None:
    shift = Shifts(likely=(lambda camera, projector, gradient: 0.05 * gradient[:, :, 0],), smooth_px=0.02)
    found = case.estimate(
        shifts=[shift] * STATIONS,
    )
    before, after = (np.sqrt(np.nan_to_num(np.diag(each.covariance))) for each in (case.found, found))
    assert np.all(after >= before)
    assert 1.2 < after[0] / before[0] < 100


def test_smooth_errors_that_residuals_would_show_are_not_assumed(case: Case) -> None:
    """These cells have no smooth errors, whatever is stated about the decoder."""
    places = slice(SHARED + PER_POSE, SHARED + PER_POSE * STATIONS)
    before = np.sqrt(np.diag(case.found.covariance)[places])
    found = [case.estimate(shifts=[Shifts(smooth_px=smooth_px)] * STATIONS) for smooth_px in (1e-4, 0.01, 0.1)]
    larger = [float(np.median(np.sqrt(np.diag(each.covariance)[places]) / before)) for each in found]
    assert 1.0 <= larger[0] < larger[1] == pytest.approx(larger[2])
    assert 1.02 < larger[1] < 1.3


def test_smooth_errors_widen_sigmas(case: Case) -> None:
    """As of `Shifts.smooth_px`: polynomials over each plane, orthonormal on average."""
    rng, smooth_px = np.random.default_rng(0), 0.01

    def bent(cells: Cells) -> Cells:
        shift = np.zeros_like(cells.projector_px)
        for plane in np.unique(cells.plane):
            on = cells.plane == plane
            modes, _ = np.linalg.qr(monomials(cells.camera_px[on])[:, :CUBIC])
            shift[on] = smooth_px * np.sqrt(on.sum()) * modes @ rng.normal(size=(modes.shape[1], 2))
        return replace(cells, projector_px=cells.projector_px + shift)

    found = replace(case, cells=[bent(cells) for cells in case.cells])
    found = replace(found, found=found.estimate(shifts=[Shifts(smooth_px=smooth_px)] * STATIONS))
    places = slice(SHARED + PER_POSE, SHARED + PER_POSE * STATIONS)
    assert np.median([noise.inflation for noise in found.found.levels.stations]) > 1.5
    assert 0.6 < np.sqrt(np.nanmean(deviations(found)[places] ** 2)) < 1.5


def test_a_prior_on_square_walls_reduces_angle_sigmas(case: Case) -> None:
    normals = np.stack([plane.normal for plane in case.truth.planes])
    pair = min(
        ((a, b) for a in range(len(normals)) for b in range(a)),
        key=lambda pair: abs(normals[pair[0]] @ normals[pair[1]]),
    )
    found = case.estimate(
        square=[pair],
        squareness_deg=0.0,
    )
    a, b = (found.room.planes[plane].normal for plane in pair)
    assert abs(np.degrees(a @ b)) < 1e-3


def test_inconsistent_input_is_refused(case: Case) -> None:
    prior = RigPrior.from_knowledge(case.knowledge, case.start.rig)
    rest = case.start.planes, case.start.rig, prior
    with pytest.raises(ValueError, match="3 places"):
        estimate_room(case.cells, case.plane_of, case.start.places[:3], *rest)
    behind = [Pose(place.rotation @ np.diag([-1.0, 1.0, -1.0]), place.translation) for place in case.start.places]
    with pytest.raises(RefusalError, match="behind"):
        estimate_room(case.cells, case.plane_of, behind, *rest)


def turned(case: Case, station: int, turn_deg: tuple[float, float, float]) -> Case:
    """The room with one station's projector rotated about its own axes."""
    projector, stations = case.made.calibration.projector, list(case.made.stations)
    matches = stations[station].matches
    rays = projector.unproject(matches.projector_px) @ Rotation.from_rotvec(turn_deg, degrees=True).as_matrix().T
    stations[station] = replace(stations[station], matches=replace(matches, projector_px=projector.project(rays)))
    made = replace(case.made, stations=tuple(stations))
    labels = [np.unique(each.matches.labels[each.matches.labels >= 0]).tolist() for each in stations]
    cells, _ = cells_of(made, [dict(zip(*each, strict=True)) for each in zip(labels, case.plane_of, strict=True)])
    found = replace(case, made=made, cells=cells)
    return replace(found, found=found.estimate())


def test_unchanged_rigs_are_not_reported(case: Case) -> None:
    assert changed_extrinsics(case.found) == ()


@pytest.mark.parametrize(("station", "turn_deg"), [(2, (0.0, 0.02, 0.0)), (4, (0.01, 0.0, 0.03))])
def test_a_small_rotation_is_found_with_its_size(
    case: Case, station: int, turn_deg: tuple[float, float, float]
) -> None:
    (found,) = changed_extrinsics(turned(case, station, turn_deg).found)
    assert found.station == station
    assert found.turn_deg == pytest.approx(float(np.linalg.norm(turn_deg)), rel=0.2)
    assert 0.01 < found.px < 0.5
