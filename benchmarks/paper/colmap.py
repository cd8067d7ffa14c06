"""COLMAP on the two views of a rig, in the paper's four variants.

COLMAP on many photographs of a room with textured walls: the well-posed task that the paper compares with.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from colmap_two_view import TwoViews, two_views, unknown_focal

from calib.geometry import Calibration, Matches, Size
from hw.settings import SimulatedRigSettings
from hw.simulated import Optics, PlacedDevice, SimulatedRoom, draw_camera_pose
from paper.captures import settings_of
from paper.published import RANDOM_START_SHORT_BY

_ADJUSTMENTS = 10  # COLMAP's end before they have converged
MATCHES = 10_000  # matches per capture for COLMAP: its time grows with them, its error does not depend on them
VIEWS = 20
_STREAM = 900  # stream of random numbers; the rooms use others
_LIT_BY_THE_CEILING = 10.0
_DARK = Size(64, 36)  # the projector's picture
_MOST_FEATURES = 4000
_HALF_PX = 0.5  # COLMAP's first pixel centre is at (0.5, 0.5)


def centre_start(truth: Calibration) -> tuple[float, float]:
    """C: the projector's principal point at its image's centre."""
    return (truth.projector.width - 1) / 2, (truth.projector.height - 1) / 2


def paper_start(truth: Calibration) -> tuple[float, float]:
    """R: the paper's own random start, from its table."""
    x, y = np.array(truth.projector.principal_point_px) * (1 - np.array(RANDOM_START_SHORT_BY))
    return float(x), float(y)


def drawn_start(truth: Calibration, rng: np.random.Generator) -> tuple[float, float]:
    """R: a random point in the projector's image."""
    x, y = rng.uniform(0, truth.projector.size)
    return float(x), float(y)


def variants(
    matches: Matches, truth: Calibration, start_px: tuple[float, float]
) -> tuple[Calibration | None, Calibration | None]:
    """Errors without and with the additional bundle adjustment; None where COLMAP finds no solution.

    The camera's principal point is the true one. Focal lengths start at COLMAP's default and are adjusted with fixed
    principal points; the additional adjustment frees both principal points together, as COLMAP does.
    """
    camera = unknown_focal(*truth.camera.size, truth.camera.principal_point_px)
    found = two_views(matches, camera, unknown_focal(*truth.projector.size, start_px))
    if found is None:
        return None, None
    results: list[Calibration | None] = []
    for free in (False, True):
        found.adjust(free_principal_point=free)
        results.append(_calibration_of(found))
    return results[0], results[1]


def with_known_points(matches: Matches, truth: Calibration, *, from_truth: bool) -> Calibration | None:
    """COLMAP's solution with both true principal points, adjusted until it converges; None if it finds none.

    It starts at COLMAP's default focal lengths, or at the true ones.
    """
    devices = [
        replace(device, distortion=(0.0,) * 5) if from_truth else unknown_focal(*device.size, device.principal_point_px)
        for device in (truth.camera, truth.projector)
    ]
    found = two_views(matches, *devices)
    if found is None:
        return None
    for _ in range(_ADJUSTMENTS):
        found.adjust(free_principal_point=False)
    return _calibration_of(found)


def _calibration_of(found: TwoViews) -> Calibration | None:
    try:
        return found.calibration
    except ValueError as error:
        print(f"    COLMAP ran off: {error}")
        return None


def room_of_photos(room: int, camera_size: Size) -> SimulatedRoom:
    """The room of a capture with patterned walls and floor, lit by its ceiling only."""
    plain = settings_of(room).model_dump()
    settings = SimulatedRigSettings.model_validate(plain | {"ambient": _LIT_BY_THE_CEILING, "wallpaper": True})
    return SimulatedRoom(settings, camera_size, _DARK)


def photograph(room: SimulatedRoom, folder: Path, count: int = VIEWS) -> Optics:
    """Write this many photos as PNG, from ordinary camera poses; returns the optics."""
    rng = np.random.default_rng([room.settings.seed, _STREAM])
    scene, optics = room.room.scene, room.room.camera.optics
    black = np.zeros(_DARK[::-1], np.uint8)
    taken = 0
    while taken < count:
        camera = PlacedDevice(optics, *draw_camera_pose(rng))
        if scene.is_free(camera.centre[:, None]).all():
            electrons = room.sensor.electrons(room.renderer.moved(camera, room.room.projector).render(black))
            cv2.imwrite(str(folder / f"{taken:02}.png"), room.sensor.read(electrons, rng))
            taken += 1
    return optics


def focal_error_percent(room: int, camera_size: Size, count: int = VIEWS) -> tuple[float, int] | None:
    """Error of COLMAP's focal length, and the number of registered photos; None if it registered none.

    The principal point is known and fixed, the lens has two radial terms, as the truth has. Needs pycolmap.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "photos").mkdir()
        optics = photograph(room_of_photos(room, camera_size), folder / "photos", count)
        found = _reconstructed(folder, optics)
    return None if found is None else (100 * (found[0] / optics.focal_px - 1), found[1])


def _reconstructed(folder: Path, optics: Optics) -> tuple[float, int] | None:
    import pycolmap

    database, photos = folder / "database.db", folder / "photos"
    x0, y0 = (coordinate + _HALF_PX for coordinate in optics.principal_point_px)
    reading = pycolmap.ImageReaderOptions()
    reading.camera_model = "RADIAL"
    reading.camera_params = f"{1.2 * optics.width},{x0},{y0},0,0"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu, extraction.sift.max_num_features = False, _MOST_FEATURES
    extraction.num_threads = 1
    single = pycolmap.CameraMode.SINGLE
    device = pycolmap.Device.cpu
    pycolmap.extract_features(
        database, photos, camera_mode=single, reader_options=reading, extraction_options=extraction, device=device
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu, matching.num_threads = False, 1
    pycolmap.match_exhaustive(database, matching_options=matching, device=device)
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.random_seed, mapping.num_threads = 0, 1
    models = pycolmap.incremental_mapping(database, photos, folder, mapping)
    if not models:
        return None
    model = max(models.values(), key=lambda each: each.num_reg_images())
    (camera,) = model.cameras.values()
    return float(camera.params[0]), int(model.num_reg_images())
