"""Photos from top to bottom: features → matches → faces → calibration → cloud → files.

As with captures, what was found is written also when RefusalError is raised: the matches are worth keeping, and the
report says why.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.geometry import Corner, Matches
from calib.numerics import Bools
from calib.plane_segmentation import find_alike, find_sparse_faces
from calib.pointcloud import View, build_cloud, merged
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, anywhere, calibrate_photos
from scanner.capture import CaptureFacts
from scanner.configuration import Config, ScaleSettings
from scanner.errors import InputError
from scanner.io import write_ply
from scanner.photos.dense import dense_cloud
from scanner.photos.features import find_features, match_features, refuse_unrelated
from scanner.photos.photo import Photo
from scanner.reconstruction import label_by_masks, refuse_few, refuse_misfit, save, scaled
from scanner.results import DENSE_FILE, Findings, Scan
from scanner.ui import Terminal

_EXIF_SIGMA = 0.05  # EXIF focal lengths are rounded to millimetres, and those of zoom lenses are nominal


@dataclass(frozen=True)
class PhotoOptions:
    """`matches`: given ones, of two photos; `masks` (3, H, W): faces drawn in the first photo; `exif_prior`: use the
    focal length that EXIF states; `dense`: match every pixel of the first two photos as well.
    """

    matches: Matches | None = None
    masks: Bools | None = None
    exif_prior: bool = False
    dense: bool = False


def reconstruct_photos(
    photos: Sequence[Photo], options: PhotoOptions, config: Config, folder: Path, terminal: Terminal
) -> Scan:
    """Two or more photos of one camera → a result. Raises RefusalError, InputError."""
    focal_px = _exif_prior(photos[0]) if options.exif_prior else None
    scan = Scan(_pairs(photos, options.matches))
    try:
        if options.matches is None:
            with terminal.step("Matching"):
                _match(scan, photos)
        with terminal.step("Finding the faces"):
            _label(scan, options.masks)
        with terminal.step("Calibrating"):
            _calibrate(scan, config, focal_px)
        with terminal.step("Triangulating"):
            _triangulate(scan)
    except RefusalError as refusal:
        save(scan, folder, refusal)
        raise
    if options.dense:
        with terminal.step("Matching every pixel"):
            assert scan.newest.calibration is not None
            cloud = dense_cloud(photos[0], photos[1], scan.newest.calibration, scan.newest.matches)
            write_ply(folder / DENSE_FILE, cloud)
    with terminal.step("Writing the result"):
        save(scan, folder)
    return scan


def refuse_unsuitable(config: Config) -> None:
    """Raise InputError for settings that mean nothing, or something else, for photos."""
    if config.method == "paper":
        raise InputError("'method: paper' needs the principal point; photos are calibrated with 'method: refined'")
    if config.earlier:
        raise InputError("'earlier' is for captures of a rig; give all photos on the command line instead")


def principal_point(config: Config, size: tuple[int, int]) -> PrincipalPoint:
    """What is known of the principal point: nothing, unless the configuration says otherwise."""
    setting = config.camera.principal_point
    if setting.known is None and setting.prior is None and setting.sigma_px is None:
        return anywhere(size)
    return config.principal_point(size)


def _exif_prior(photo: Photo) -> tuple[float, float]:
    if photo.focal_px is None:
        raise InputError(
            f"{photo.path}: --exif-prior needs the EXIF tag FocalLengthIn35mmFilm, which this photo does not have"
        )
    return photo.focal_px, _EXIF_SIGMA * photo.focal_px


def _pairs(photos: Sequence[Photo], matches: Matches | None) -> list[Findings]:
    """The first photo with each of the others, the second one last: a result is about what comes last."""
    first = photos[0]
    none = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    exif = "not stated" if first.focal_px is None else f"{first.focal_px:.0f} px"
    return [
        Findings(
            CaptureFacts(
                first.size,
                second.size,
                identity={"first photo": str(first.path), "second photo": str(second.path), "focal length, EXIF": exif},
                photos=True,
            ),
            matches or none,
            name=f"{first.path.name} and {second.path.name}",
            photograph=first.pixels,
        )
        for second in reversed(photos[1:])
    ]


def _match(scan: Scan, photos: Sequence[Photo]) -> None:
    features = [find_features(photo.pixels) for photo in photos]
    for found, second in zip(scan.captures, reversed(features[1:]), strict=True):
        found.matches = match_features(features[0], second)
        with scan.naming(found):
            refuse_unrelated(found.matches, features[0], second)


def _label(scan: Scan, masks: Bools | None) -> None:
    newest = scan.newest
    for found in reversed(scan.captures):
        with scan.naming(found):
            if masks is not None:
                found.matches = label_by_masks(found.matches, masks)
            elif found is not newest:
                faces = find_alike(newest.matches, found.matches, found.facts.camera_size)
                found.matches, found.plane = faces.matches, faces.plane
            elif found.matches.face is None:
                faces = find_sparse_faces(found.matches, found.facts.camera_size)
                found.matches, found.plane = faces.matches, faces.plane
            refuse_few(found.matches, "See that all three faces are in both photos, with texture to match on each.")


def _calibrate(scan: Scan, config: Config, focal_px: tuple[float, float] | None) -> None:
    """Solutions for all pairs; lengths in metres, or each pair's in its own baseline."""
    size = scan.newest.facts.camera_size
    pairs = list(reversed(scan.captures))
    solutions = calibrate_photos(
        [found.matches for found in pairs],
        size,
        principal_point=principal_point(config, size),
        squareness_deg=config.corner.squareness_deg,
        focal_px=focal_px,
    )
    scale = config.scale
    for found, solution in zip(pairs, solutions, strict=True):
        found.solution = solution
        found.calibration = scaled(solution.calibration, solution.corner, scale)
        if scale is not None:  # a baseline is that of the first two photos; the corner is the same for all
            scale = ScaleSettings(camera_to_corner_m=_distance(found))


def _distance(found: Findings) -> float:
    """From the first photo's place to the corner's vertex, in the unit of the pair's calibration."""
    assert found.solution is not None
    assert found.calibration is not None
    return float(np.linalg.norm(found.solution.corner.vertex)) * found.calibration.baseline


def _triangulate(scan: Scan) -> None:
    for found in scan.captures:
        assert found.calibration is not None
        found.cloud = build_cloud(found.matches, found.texture, found.calibration, scattered=True)
        with scan.naming(found):
            refuse_misfit(found.cloud.statistics)
    if len(scan.captures) > 1:
        _merge(scan)


def _merge(scan: Scan) -> None:
    """All points in the corner's frame: every pair has the first photo's, so how they belong together is known."""
    newest = scan.newest
    assert newest.solution is not None
    assert newest.calibration is not None
    corner = Corner(newest.solution.corner.vertex * newest.calibration.baseline, newest.solution.corner.legs)
    clouds = []
    for found in scan.captures:
        assert found.cloud is not None
        factor = np.float32(_distance(newest) / _distance(found))
        clouds.append(replace(found.cloud, points=found.cloud.points * factor))
    views = [View(cloud.points, None, newest.calibration.camera, corner) for cloud in clouds]
    scan.merged = merged(clouds, views, (0,) * len(clouds))
