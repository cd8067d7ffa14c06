"""Why a view of a corner calibrates badly: each kind of degenerate geometry, recognised and named.

Nothing here decides whether an answer can be trusted; the covariance and the residuals do. Once it cannot, this says
what a person should change.
"""

import numpy as np

from calib.arrays import Floats
from calib.cells import Cells
from calib.homography import FACES, dehomogenise, dlt_gram, homogeneous, homography_from_gram, normalisation
from calib.model import State

_NAMES = ("first", "second", "third")
# What an angle or a share must fall below to be named as a reason.
_GRAZING_DEG = 8.0
_BASELINE_IN_FACE_DEG = 4.0
_FORWARD_DEG = 12.0
_SMALL_SHARE = 0.03
_ONE_PLANE_OF_SIZE = 0.004  # deviation from a common homography, in sizes of the matches in the projector
_SHORT_BASELINE = 0.03  # of the distance to the vertex


def reasons_in_images(cells: Cells) -> list[str]:
    """What is wrong whatever the devices are: faces that lie in one plane, or hold too little of the matches."""
    reasons = []
    size = float(np.linalg.norm(np.ptp(cells.projector_px, axis=0)))
    together = [(i, j) for i, j in ((0, 1), (1, 2), (2, 0)) if _off_one_plane(cells, i, j) < _ONE_PLANE_OF_SIZE * size]
    if len(together) >= 2:
        reasons.append(
            "all faces lie in one plane (a flat wall), or camera and projector are in one place: there is no depth"
        )
    elif together:
        i, j = together[0]
        reasons.append(f"the {_NAMES[i]} and the {_NAMES[j]} face lie in one plane: only two planes are seen")
    for face in FACES:
        on_face = cells.camera_px[cells.plane == face]
        extent = np.linalg.norm(np.ptp(on_face, axis=0)) / np.linalg.norm(np.ptp(cells.camera_px, axis=0))
        thickness = np.sqrt(np.linalg.eigvalsh(np.cov(on_face.T))[0]) / np.linalg.norm(np.ptp(cells.camera_px, axis=0))
        if extent < 5 * _SMALL_SHARE:
            reasons.append(f"the {_NAMES[face]} face is small: {100 * extent:.0f} % of the picture of the corner")
        elif thickness < _SMALL_SHARE / 3:
            reasons.append(f"the {_NAMES[face]} face is seen as a line: it passes nearly through the camera's centre")
    return reasons


def reasons_in_space(state: State, capture: int) -> list[str]:
    """What is wrong with the places of corner, camera and projector, as far as a poor solution can tell."""
    reasons = []
    vertex = state.poses[capture].vertex
    normals = state.normals(capture)
    projector = -state.rotation.T @ state.translation
    for device, centre in (("camera", np.zeros(3)), ("projector", projector)):
        slant = np.degrees(
            np.arcsin(np.clip(np.abs(normals @ (vertex - centre)) / np.linalg.norm(vertex - centre), 0, 1))
        )
        reasons += [
            f"the {_NAMES[face]} face is seen at a slant of only {slant[face]:.0f}° from the {device}: "
            f"the face passes nearly through its centre"
            for face in FACES
            if slant[face] < _GRAZING_DEG
        ]
    along = np.degrees(np.arcsin(np.clip(np.abs(normals @ projector) / np.linalg.norm(projector), 0, 1)))
    reasons += [
        f"the line from camera to projector runs along the {_NAMES[face]} face ({along[face]:.0f}°)"
        for face in FACES
        if along[face] < _BASELINE_IN_FACE_DEG
    ]
    ahead = np.degrees(np.arccos(np.clip(abs(projector @ vertex) / np.linalg.norm(vertex), 0, 1)))
    if ahead < _FORWARD_DEG:
        reasons.append(f"camera and projector stand behind one another ({ahead:.0f}° from the line to the corner)")
    if 1 / np.linalg.norm(vertex) < _SHORT_BASELINE:
        reasons.append(
            f"camera and projector are only {100 / np.linalg.norm(vertex):.1f} % of the distance to the corner apart"
        )
    return reasons


def _off_one_plane(cells: Cells, i: int, j: int) -> float:
    """Median deviation in projector px from one homography for two faces."""
    chosen = (cells.plane == i) | (cells.plane == j)
    camera_px, projector_px = cells.camera_px[chosen], cells.projector_px[chosen]
    camera, projector = normalisation(camera_px), normalisation(projector_px)
    source, target = (_apply(camera, camera_px), _apply(projector, projector_px))
    homography = homography_from_gram(dlt_gram(source, target))
    deviation = np.linalg.norm(_apply(homography, source) - target, axis=1) / projector[0, 0]
    return float(np.median(deviation))


def _apply(homography: Floats, points: Floats) -> Floats:
    return dehomogenise(homogeneous(points) @ homography.T)
