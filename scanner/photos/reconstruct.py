"""Photos: features → matches → faces → calibration → cloud → files.

As with captures, a RefusalError keeps the matches, and the report gives the reason.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Matches, Size
from calib.numerics import Bools
from calib.plane_segmentation import find_same_faces, find_sparse_faces
from calib.pointcloud import Cloud, CornerView, MergedCloud, build_cloud, merged
from calib.self_calibration import PrincipalPoint, SelfCalibration, anywhere, calibrate_photos
from scanner.capture import CaptureMetadata
from scanner.configuration import Config, ScaleSettings
from scanner.errors import InputError
from scanner.io import write_ply
from scanner.photos.dense import dense_cloud
from scanner.photos.features import find_features, match_features, refuse_unrelated
from scanner.photos.photo import Photo
from scanner.reconstruction import (
    label_by_masks,
    lenses_by_name,
    refusal_saved,
    refuse_few,
    refuse_misfit,
    save,
    scaled,
)
from scanner.results import DENSE_FILE, Decoded, GivenMatches, Reconstructed, Scan, SelfCalibrated, Stage, naming
from scanner.ui import Terminal

_EXIF_SIGMA = 0.05  # EXIF focal lengths are rounded to millimetres, and those of zoom lenses are nominal

EXIF_FOCAL = FindingKind(
    "exif-focal",
    "What the photos' EXIF data state of the focal length.",
    "--exif-prior uses it.",
    ("focal_px",),
)
REDUCED_PHOTOS = FindingKind(
    "reduced-photos",
    "The photos are larger than any lens resolves; they were reduced, and results are in the reduced pixels.",
    data=("reduction_ratio",),
)


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
    pairs = _pairs(photos, options.matches or Matches(np.zeros((0, 2)), np.zeros((0, 2))))
    with refusal_saved(pairs, folder, config) as reached:
        if options.matches is None:
            with terminal.step("Matching"):
                pairs = _match(pairs, photos, reached)
        with terminal.step("Finding the faces"):
            pairs = _label(pairs, options.masks, reached)
        with terminal.step("Calibrating"):
            reached[:] = calibrated = _calibrate(pairs, config, focal_px)
        with terminal.step("Triangulating"):
            scan = _triangulate(calibrated, reached)
    if options.dense:
        with terminal.step("Matching every pixel"):
            newest = scan.newest
            cloud = dense_cloud(photos[0], photos[1], newest.calibration, newest.decoded.matches)
            write_ply(folder / DENSE_FILE, cloud)
    scan = replace(scan, own_findings=(*scan.own_findings, *_findings_on(photos[0], exif_prior=options.exif_prior)))
    with terminal.step("Writing the result"):
        save(scan, folder, config)
    return scan


def _findings_on(photo: Photo, *, exif_prior: bool) -> Iterator[Finding]:
    if photo.focal_px is None:
        yield Finding(EXIF_FOCAL, Severity.NOTE, "EXIF: no focal length")
    else:
        used = "used as a prior" if exif_prior else "not used; --exif-prior uses it"
        message = f"EXIF: focal length {photo.focal_px:.0f} px ({used})"
        yield Finding(EXIF_FOCAL, Severity.NOTE, message, data={"focal_px": photo.focal_px})
    if photo.reduced > 1:
        yield Finding(
            REDUCED_PHOTOS,
            Severity.NOTE,
            f"Photos: reduced {photo.reduced} times, to {photo.size} pixels; results are in pixels of that size",
            data={"reduction_ratio": float(photo.reduced)},
        )


def refuse_unsuitable(config: Config) -> None:
    """Raise InputError for settings that mean nothing, or something else, for photos."""
    if config.method == "paper":
        raise InputError("'method: paper' needs the principal point; photos are calibrated with 'method: refined'")
    if config.earlier:
        raise InputError("'earlier' is for captures of a rig; give all photos on the command line instead")


def principal_point(config: Config, size: Size) -> PrincipalPoint:
    """Return the prior of the principal point: none, unless the configuration gives one."""
    setting = config.camera.principal_point
    if not setting.given:
        return anywhere(size)
    return config.principal_point(size)


def _exif_prior(photo: Photo) -> tuple[float, float]:
    if photo.focal_px is None:
        raise InputError(
            f"{photo.path}: --exif-prior needs the EXIF tag FocalLengthIn35mmFilm, which this photo does not have"
        )
    return photo.focal_px, _EXIF_SIGMA * photo.focal_px


def _pairs(photos: Sequence[Photo], matches: Matches) -> list[Decoded]:
    """The first photo with each of the others, the second one last, because the result concerns the last pair."""
    first = photos[0]
    exif = "not stated" if first.focal_px is None else f"{first.focal_px:.0f} px"
    return [
        Decoded(
            CaptureMetadata(
                first.size,
                second.size,
                identity={"first photo": str(first.path), "second photo": str(second.path), "focal length, EXIF": exif},
                photos=True,
            ),
            matches,
            GivenMatches(first.pixels),
            f"{first.path.name} and {second.path.name}",
        )
        for second in reversed(photos[1:])
    ]


def _match(pairs: Sequence[Decoded], photos: Sequence[Photo], reached: list[Stage]) -> list[Decoded]:
    features = [find_features(photo.pixels) for photo in photos]
    matched = []
    for number, (pair, second) in enumerate(zip(pairs, reversed(features[1:]), strict=True)):
        matches = match_features(features[0], second)
        reached[number] = stage = pair.with_matches(matches, None)
        with naming(pair, among=len(pairs)):
            refuse_unrelated(matches, features[0], second)
        matched.append(stage)
    return matched


def _label(pairs: Sequence[Decoded], masks: Bools | None, reached: list[Stage]) -> list[Decoded]:
    """The newest pair's faces, and then the same ones in the others."""
    labelled = list[Decoded]()
    for pair in reversed(pairs):
        with naming(pair, among=len(pairs)):
            labels = _labelled(pair, masks, labelled[0] if labelled else None)
            labelled.append(labels)
            reached[-len(labelled)] = labels
            refuse_few(labels.matches, "See that all three faces are in both photos, with texture to match on each.")
    return labelled[::-1]


def _labelled(pair: Decoded, masks: Bools | None, newest: Decoded | None) -> Decoded:
    matches, size = pair.matches, pair.metadata.camera_size
    if masks is not None:
        return pair.with_matches(label_by_masks(matches, masks), pair.plane)
    if newest is not None:
        faces = find_same_faces(newest.matches, matches, size)
    elif matches.face is None:
        faces = find_sparse_faces(matches, size)
    else:
        return pair
    return pair.with_matches(faces.matches, faces.plane)


def _calibrate(pairs: Sequence[Decoded], config: Config, focal_px: tuple[float, float] | None) -> list[SelfCalibrated]:
    """Solutions for all pairs; lengths in metres, or in the baseline of the first two photos."""
    size, camera = pairs[-1].metadata.camera_size, "photos"
    lens = lenses_by_name(config, {camera: size}, {})[camera]
    solutions = calibrate_photos(
        [pair.matches for pair in reversed(pairs)],
        size,
        principal_point=principal_point(config, size),
        squareness_deg=config.corner.squareness_deg,
        lenses=(lens, lens),
        focal_px=focal_px,
    )
    first = _scaled(pairs[-1], solutions[0], config.scale)
    further = [
        _alike(_scaled(pair, solution, None), first)
        for pair, solution in zip(reversed(pairs[:-1]), solutions[1:], strict=True)
    ]
    return [first, *further][::-1]


def _scaled(pair: Decoded, solution: SelfCalibration, scale: ScaleSettings | None) -> SelfCalibrated:
    return SelfCalibrated(pair, solution, scaled(solution.calibration, solution.corner, scale))


def _alike(pair: SelfCalibrated, first: SelfCalibrated) -> SelfCalibrated:
    """The pair in the first one's unit: the corner is the same, and so is its distance from the first photo."""
    calibration, distance, known = pair.calibration, _distance(first), first.calibration.sigma
    in_unit = calibration.scaled(distance / _distance(pair), first.calibration.unit)
    if known.known_camera_to_corner is not None:
        sigma = replace(calibration.sigma, known_camera_to_corner=known.known_camera_to_corner)
    elif known.known_baseline is not None:
        relative = known.known_baseline / first.calibration.baseline
        sigma = replace(calibration.sigma, known_camera_to_corner=relative * distance)
    else:
        sigma = calibration.sigma
    return replace(pair, calibration=replace(in_unit, sigma=sigma))


def _distance(pair: SelfCalibrated) -> float:
    """Return the distance from the first photo's position to the corner's vertex, in the unit of the pair's
    calibration.
    """
    return float(np.linalg.norm(pair.corner.vertex))


def _triangulate(pairs: Sequence[SelfCalibrated], reached: list[Stage]) -> Scan:
    captures = []
    for number, pair in enumerate(pairs):
        cloud = build_cloud(pair.decoded.matches, pair.decoded.texture, pair.calibration, scattered=True)
        reached[number] = stage = Reconstructed(pair, cloud)
        with naming(pair.decoded, among=len(pairs)):
            refuse_misfit(cloud.statistics)
        captures.append(stage)
    clouds = [capture.cloud for capture in captures]
    return Scan(tuple(captures), _merged(pairs, clouds) if len(pairs) > 1 else None)


def _merged(pairs: Sequence[SelfCalibrated], clouds: Sequence[Cloud]) -> MergedCloud:
    """All points in the corner's frame: every pair has the first photo's, so how they belong together is known."""
    newest = pairs[-1]
    views = [CornerView(cloud.points, None, newest.calibration.camera, newest.corner) for cloud in clouds]
    return merged(clouds, views, (0,) * len(clouds))
