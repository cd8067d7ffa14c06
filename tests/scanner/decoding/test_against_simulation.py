"""Decode a simulated room with interreflection, gamma, blur and noise, and compare with the
simulator's ground truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import pytest

from calib.geometry import Calibration, Pose
from hw.settings import SimulatedRigSettings
from hw.simulated import GroundTruth, SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.decoding.decoder import Decoder, Decoding
from scanner.decoding.mask_reasons import MaskReason
from scanner.patterns import PRESETS, Axis, Black, Pattern, PresetName, White, draw, sequence_for

CAMERA, PROJECTOR = (612, 512), (428, 240)
FACES = 3

pytestmark = pytest.mark.xdist_group("decode-simulation")


@dataclass(frozen=True)
class Scanned:
    decoding: Decoding
    truth: GroundTruth

    @cached_property
    def error_px(self) -> np.ndarray:
        """Return the error of each match (N, 2), NaN where the projector does not light the pixel directly."""
        x, y = np.rint(self.decoding.matches.camera_px).astype(int).T
        return self.decoding.matches.projector_px - self.truth.projector_px[y, x]

    @property
    def distance_px(self) -> np.ndarray:
        length = np.linalg.norm(self.error_px, axis=1)
        return length[np.isfinite(length)]

    @property
    def error_in_sigmas(self) -> np.ndarray:
        assert self.decoding.matches.sigma_px is not None
        ratio = self.error_px / self.decoding.matches.sigma_px[:, None]
        return ratio[np.isfinite(ratio[:, 0])]

    @cached_property
    def lit(self) -> np.ndarray:
        return np.isfinite(self.truth.projector_px[..., 0])


def scanned(room: SimulatedRoom, patterns: Sequence[Pattern], calibration: Calibration | None = None) -> Scanned:
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    decoder = Decoder(patterns, PROJECTOR, calibration)
    for pattern in patterns:
        projector.show(draw(pattern, PROJECTOR))
        decoder.add(camera.grab().image)
    return Scanned(decoder.finish(), room.ground_truth())


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0, albedo=0.8), CAMERA, PROJECTOR)


@pytest.fixture(scope="module")
def results(room: SimulatedRoom) -> dict[PresetName, Scanned]:
    return {preset: scanned(room, PRESETS[preset].patterns(PROJECTOR)) for preset in PRESETS}


@dataclass(frozen=True)
class Limits:
    """Limits of the errors in projector pixels: median, 99.9th percentile, and root mean square of the means over
    cells.

    `kept`: least share of the lit pixels. Only the preset quick has no second period to detect bits inverted by global
    light, and has to mask them.
    """

    median: float
    largest: float
    of_cells: float
    kept: float


LIMITS: dict[PresetName, Limits] = {
    "quick": Limits(0.05, 0.6, 0.01, 0.95),
    "standard": Limits(0.04, 0.5, 0.006, 0.97),
    "concave": Limits(0.04, 0.5, 0.006, 0.98),
}


@pytest.mark.parametrize("preset", PRESETS)
def test_error_of_the_matches(results: dict[PresetName, Scanned], preset: PresetName) -> None:
    distance, limits = results[preset].distance_px, LIMITS[preset]
    assert 0.005 < np.median(distance) < limits.median
    assert 0.05 < np.percentile(distance, 99.9) < limits.largest


@pytest.mark.parametrize("preset", PRESETS)
def test_share_of_the_lit_pixels_that_is_kept(results: dict[PresetName, Scanned], preset: PresetName) -> None:
    result = results[preset]
    kept = result.decoding.reasons == MaskReason.KEPT
    whole = cv2.erode(result.lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert LIMITS[preset].kept < (kept & whole).sum() / whole.sum() <= 1.0
    # Penumbra pixels are lit a little although their centre is not.
    assert (kept & ~result.lit).sum() / kept.sum() < 0.002


@pytest.mark.parametrize("preset", PRESETS)
def test_sigmas_match_the_errors(results: dict[PresetName, Scanned], preset: PresetName) -> None:
    assert 0.8 < np.std(results[preset].error_in_sigmas) < 1.25


@pytest.mark.parametrize("preset", PRESETS)
def test_errors_average_out_away_from_creases(results: dict[PresetName, Scanned], preset: PresetName) -> None:
    """Means over cells, as a calibration uses them. Noise leaves 0.002 px; a shaded edge used to leave 0.02."""
    result = results[preset]
    near = [cv2.dilate((result.truth.label == face).astype(np.uint8), np.ones((41, 41), np.uint8)) for face in range(3)]
    far = (sum(near) == 1) & (result.truth.label < FACES)
    x, y = np.rint(result.decoding.matches.camera_px).astype(int).T
    good = far[y, x] & np.isfinite(result.error_px[:, 0])
    _, cell, count = np.unique((y // 16 * 1000 + x // 16)[good], return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(cell, error[good]) / count for error in result.error_px.T], axis=1)[count > 128]
    assert len(means) > 50
    assert 0.0005 < np.sqrt(np.mean(means**2)) < LIMITS[preset].of_cells


def test_a_dark_room_is_masked_not_guessed() -> None:
    settings = SimulatedRigSettings(seed=0, albedo=0.05, ambient=2.0, interreflection=False)
    dim = scanned(SimulatedRoom(settings, CAMERA, PROJECTOR), PRESETS["standard"].patterns(PROJECTOR))
    assert 0.01 < np.median(dim.distance_px) < 0.5
    assert np.percentile(dim.distance_px, 99) < 3.0


CODES = sequence_for(PROJECTOR, cell=1, shifts=0)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(
    ("patterns", "median", "largest"),
    [(PRESETS["standard"].patterns(PROJECTOR), (0.01, 0.05), (0.1, 0.8)), (CODES, (0.005, 0.05), (0.2, 1.5))],
    ids=["fringes", "codes"],
)
def test_one_axis_and_the_calibration_give_both_coordinates(
    room: SimulatedRoom,
    axis: Axis,
    patterns: Sequence[Pattern],
    median: tuple[float, float],
    largest: tuple[float, float],
) -> None:
    """Without white and black frames. The other coordinate has the error of the measured one, times the slope."""
    alone = [p for p in patterns if not isinstance(p, White | Black) and p.axis == axis]
    result = scanned(room, alone, room.calibration)
    assert result.decoding.only_axis == axis
    assert median[0] < np.median(result.distance_px) < median[1]
    assert largest[0] < np.percentile(result.distance_px, 99.9) < largest[1]
    kept = result.decoding.reasons == MaskReason.KEPT
    whole = cv2.erode(result.lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert 0.88 < (kept & whole).sum() / whole.sum() <= 1.0
    sigma_px = result.decoding.matches.sigma_px
    assert sigma_px is not None
    # Sigma is along the epipolar line, and so is all error except that of the camera pixel itself.
    ratio = np.linalg.norm(result.error_px, axis=1) / sigma_px
    assert 0.8 < np.nanmedian(ratio) / 0.6745 < 1.25


def test_stripes_along_the_epipolar_lines_are_masked(room: SimulatedRoom) -> None:
    """With the projector straight above the camera, only y determines distances."""
    true = room.calibration
    above = replace(true, pose=Pose(np.eye(3), np.array([0.0, 0.4, 0.0])))
    patterns = [p for p in PRESETS["quick"].patterns(PROJECTOR) if getattr(p, "axis", "x") == "x"]
    decoding = scanned(room, patterns, above).decoding
    assert not len(decoding.matches)
    lit = np.isfinite(room.ground_truth().projector_px[..., 0])
    assert (decoding.reasons[lit] == MaskReason.ALONG_EPIPOLAR_LINE).mean() > 0.9
