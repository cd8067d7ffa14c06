"""COLMAP's two-view solution through pycolmap, where that is installed: relative pose, points, bundle adjustment.

One camera for both photos, started as COLMAP starts one of which nothing is known: a focal length of 1.2 image widths
and the principal point at the centre, which is then held or freed. COLMAP logs every adjustment on stderr.
"""

import importlib.util

import numpy as np

from calib.geometry import Calibration, Intrinsics, Matches, intersect

HELD, FREE = "PP at the centre", "PP free"
PEERS = (HELD, FREE) if importlib.util.find_spec("pycolmap") else ()


def two_view(matches: Matches, size: tuple[int, int], peer: str) -> np.ndarray | None:
    """(f, x_0, y_0) in pixels, in this project's convention of pixel centres; None where COLMAP finds no solution."""
    import pycolmap

    focal, centre = 1.2 * max(size), (np.array(size) - 1) / 2
    # COLMAP has the centre of the first pixel at (0.5, 0.5).
    parameters = [focal, *(centre + 0.5)]
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=size[0], height=size[1], params=parameters, camera_id=1)
    first, second = matches.camera_px + 0.5, matches.projector_px + 0.5
    pairs = np.stack([np.arange(len(matches))] * 2, axis=1).astype(np.uint32)
    geometry = pycolmap.estimate_calibrated_two_view_geometry(camera, first, camera, second, pairs)
    if not pycolmap.estimate_two_view_geometry_pose(camera, first, camera, second, geometry):
        return None
    motion = geometry.cam2_from_cam1
    ours = Intrinsics(*size, (focal, focal), (float(centre[0]), float(centre[1])))
    start = Calibration(ours, ours, motion.rotation.matrix(), np.asarray(motion.translation))
    met = intersect(matches, start)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for number, (pixels, pose) in enumerate(((first, pycolmap.Rigid3d()), (second, motion)), start=1):
        image = pycolmap.Image(name=str(number), keypoints=pixels[met.in_front], camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
    for i, point in enumerate(met.points[met.in_front]):
        track = pycolmap.Track([pycolmap.TrackElement(1, i), pycolmap.TrackElement(2, i)])
        model.add_point3D(point, track)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length, options.refine_principal_point = True, peer == FREE
    options.refine_extra_params = False
    options.print_summary = False
    pycolmap.bundle_adjustment(model, options)
    found = np.array(model.cameras[1].params)
    return np.array([found[0], found[1] - 0.5, found[2] - 0.5])
