"""A projector as the virtual camera of other programs, which have no lens distortion but can shift their lens.

Let (u, v) be the principal point from the upper left corner of the image in pixels, half a pixel more than here, W × H
the image, (f_x, f_y) the focal lengths. Where the sensor is S = 36 mm wide, the lens has f_x S / W millimetres.

Blender shifts in units of the image's width where the sensor fit is horizontal: `BKE_camera_params_compute_viewplane`
adds shift · W to both sides of the view plane, so shift_x = (W/2 − u)/W and shift_y = (v − H/2) f_x / (f_y W). Its
pixels are f_x / f_y as high as they are wide.

Unity's `Camera.lensShift` is in units of the sensor's size along each axis ("relative to the sensor size"):
x = (W/2 − u)/W and y = (v − H/2)/H, with a sensor of S × S H f_x / (f_y W) and no gate fit.

Unreal's nDisplay has the projection policy `manual` with a frustum of four angles in degrees, negative to the left and
to the bottom: AngleL = −atan(u / f_x), AngleR = atan((W − u)/f_x), AngleT = atan(v / f_y), AngleB = −atan((H − v)/f_y).

TouchDesigner's Camera COMP takes a custom 4 × 4 matrix (Projection: Custom Projection Matrix) for column vectors, whose
camera looks along −z with y up, and depth from 0 to 1 as in Vulkan.
"""

from math import atan, degrees
from typing import Any

from calib.geometry import Intrinsics

_SENSOR_MM = 36.0


def for_programs(device: Intrinsics, near: float, far: float) -> dict[str, Any]:
    """What to enter in each program; `near` and `far` of the clipping planes, in metres."""
    (fx, fy), (width, height) = device.focal_px, device.size
    u, v = (value + 0.5 for value in device.principal_point_px)
    lens_mm, aspect = fx * _SENSOR_MM / width, fx / fy
    across, up = (width / 2 - u) / width, (v - height / 2) / height
    depth = far / (near - far)
    return {
        "blender": {
            "sensor_fit": "HORIZONTAL",
            "sensor_width": _SENSOR_MM,
            "lens": lens_mm,
            "shift_x": across,
            "shift_y": up * height * aspect / width,
            "pixel_aspect_x": max(1.0, 1 / aspect),
            "pixel_aspect_y": max(1.0, aspect),
            "resolution": [width, height],
        },
        "unity": {
            "sensorSize": [_SENSOR_MM, _SENSOR_MM * height * aspect / width],
            "focalLength": lens_mm,
            "lensShift": [across, up],
            "gateFit": "None",
        },
        "unreal_ndisplay_manual": {
            "AngleL": -degrees(atan(u / fx)),
            "AngleR": degrees(atan((width - u) / fx)),
            "AngleT": degrees(atan(v / fy)),
            "AngleB": -degrees(atan((height - v) / fy)),
        },
        "touchdesigner_projection_matrix": [
            [2 * fx / width, 0.0, 2 * across, 0.0],
            [0.0, 2 * fy / height, 2 * up, 0.0],
            [0.0, 0.0, depth, depth * near],
            [0.0, 0.0, -1.0, 0.0],
        ],
    }
