"""Geometry of the view: frusta, rulers, viewpoint, and what a window shows from there. Arrays only.

A scale bar for the middle of a window's view, in the cloud's unit.

Where labels go in a window so that none lies over another.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Literal

import numpy as np
from markupsafe import escape
from scipy.spatial.transform import Rotation

from calib.geometry import Intrinsics
from calib.numerics import Floats
from scanner.quantities import shown_unit
from scanner.viewing.decimation import shuffled
from scanner.viewing.result import PlacedRig, ViewedCloud

_SAMPLED = 20_000
_TICKS_WANTED = 4
FIELD_OF_VIEW_RAD = float(np.radians(50.0))
# Aspect ratio of a window beside the panel, until the browser reports it.
USUAL_ASPECT = 1.0
_MARGIN = 1.15
FRUSTUM_OF_SIZE = 0.25
_CENTRINGS = 8
_TALL_PX = 1100  # of a page; in pixels of the screen, phones are three times as high as on their pages
_ABOVE, _BESIDE = 0.7, 0.5
_WANTED_PX = 560  # four times the length that it is about to have
Anchor = Literal[
    "top-left",
    "top-center",
    "top-right",
    "center-left",
    "center-center",
    "center-right",
    "bottom-left",
    "bottom-center",
    "bottom-right",
]
# As viser draws them: 12 pixels high, a little wider than they are in most fonts.
LETTER_PX, LINE_PX, _PADDING_PX = 6.9, 18.0, 6.0
# The part of its width and height that a label has left of, and above, the point that it is at.
_BEFORE = {"left": 0.0, "center": 0.5, "right": 1.0, "top": 0.0, "bottom": 1.0}
_ANCHORS: tuple[Anchor, ...] = (
    "center-left",
    "center-right",
    "top-center",
    "bottom-center",
    "bottom-left",
    "bottom-right",
    "top-left",
    "top-right",
)


@dataclass(frozen=True)
class Viewpoint:
    """A view from `position` (3,) towards `target` (3,), with `up` (3,) at the top."""

    position: Floats
    target: Floats
    up: Floats


def typical_size(cloud: ViewedCloud) -> float:
    """Return the distance of most points from the median point, in the cloud's unit."""
    points = _some(cloud)
    return float(np.quantile(np.linalg.norm(points - np.median(points, axis=0), axis=1), 0.9)) or 1.0


def viewpoint(cloud: ViewedCloud, aspect: float = USUAL_ASPECT, upper_share: float = 1.0) -> Viewpoint:
    """Return the view from behind, above and beside the newest camera: the cloud in the middle, all devices in view.

    `aspect`: of the window, width over height; `upper_share`: the share of its height that nothing covers.
    """
    points = _some(cloud)
    middle = np.median(points, axis=0)
    devices = np.array([centre for rig in cloud.rigs for centre in (rig.position, rig.projector_centre)]).reshape(-1, 3)
    eye = cloud.rigs[0].position if cloud.rigs else np.zeros(3)
    level = middle - eye
    level = level - (level @ cloud.up) * cloud.up
    level /= np.linalg.norm(level)
    aside = np.cross(level, cloud.up)
    # Seen from beyond the camera, neither device hides the other.
    aside *= -1.0 if len(devices) and (devices.mean(axis=0) - eye) @ aside > 0 else 1.0
    backward = _ABOVE * cloud.up - level + _BESIDE * aside
    backward /= np.linalg.norm(backward)
    right = np.cross(cloud.up, backward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(backward, right), backward])
    size = typical_size(cloud)
    near = points[np.linalg.norm(points - middle, axis=1) <= 2 * size] @ axes.T  # outliers may be out of sight
    centre = (near.min(axis=0) + near.max(axis=0)) / 2
    frusta = [corners for rig in cloud.rigs for corners in frusta_of(rig, FRUSTUM_OF_SIZE * size)]
    in_view = np.concatenate([near, *(corners @ axes.T for corners in (devices, *frusta))])
    tangent = np.tan(FIELD_OF_VIEW_RAD / 2)
    # The middle and half of the height that is free, in distances from the eye.
    above, half = (1 - upper_share) * tangent, upper_share * tangent / _MARGIN
    for _ in range(_CENTRINGS):
        x, y, z = (in_view - centre).T
        beside = z + np.abs(x) / (tangent * aspect / _MARGIN)
        distance = float(np.max([beside, (y + (half + above) * z) / half, (-y + (half - above) * z) / half]))
        # What is nearer looks larger: the middle of the points is not the middle of their picture.
        seen_at = (near - centre + (0, above * distance, 0))[:, :2] / (distance - (near - centre)[:, 2:])
        aside_of_middle = (seen_at.min(axis=0) + seen_at.max(axis=0)) / 2 - (0, above)
        centre[:2] += aside_of_middle * distance
    target = centre @ axes - above * distance * axes[1]
    return Viewpoint(target + distance * backward, target, cloud.up)


@dataclass(frozen=True)
class WindowView:
    """What a window shows."""

    position: Floats
    """From where, (3,)."""
    axes: Floats
    """Rows point to its right, downwards and ahead, (3, 3)."""
    fov_rad: float
    """From its top to its bottom."""
    width: int
    """In pixels."""
    height: int
    """In pixels."""

    @property
    def density(self) -> int:
        """How many of these pixels, at most, one of its text is: they are those of the screen, not of the page."""
        return density_of(self.height)

    @classmethod
    def towards(cls, view: Viewpoint, fov_rad: float, width: int, height: int) -> "WindowView":
        """The view of a window from a place, upright."""
        ahead = (view.target - view.position) / np.linalg.norm(view.target - view.position)
        right = np.cross(ahead, view.up)
        right /= np.linalg.norm(right)
        return cls(view.position, np.stack([right, np.cross(ahead, right), ahead]), fov_rad, width, height)

    @property
    def focal_px(self) -> float:
        """The distance, in pixels, at which a length is as many pixels long."""
        return float(self.height / 2 / np.tan(self.fov_rad / 2))

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Pixels (N, 2) of points (N, 3) from the window's top left, and how far ahead they are, (N,).

        Pixels of points that are not ahead mean nothing.
        """
        before = (points - self.position) @ self.axes.T
        depth = before[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = self.focal_px * before[:, :2] / depth[:, None] + (self.width / 2, self.height / 2)
        return pixels, depth


def density_of(height: int) -> int:
    """How many pixels of the screen, at most, are one of a page in a window so high."""
    return max(1, ceil(height / _TALL_PX))


def turned(view: Viewpoint, angle_rad: float) -> Viewpoint:
    """The same view after a turn about the upright axis through its target."""
    about = Rotation.from_rotvec(angle_rad * view.up / np.linalg.norm(view.up))
    return Viewpoint(view.target + about.apply(view.position - view.target), view.target, view.up)


def _some(cloud: ViewedCloud) -> Floats:
    return cloud.points[shuffled(len(cloud.points))[:_SAMPLED]]


def frusta_of(rig: PlacedRig, depth: float) -> tuple[Floats, Floats]:
    """The corners (4, 3) of the camera's and the projector's picture at `depth` before them, in the cloud's frame."""
    calibration = rig.calibration
    in_projector = picture_corners(calibration.projector, depth)
    of_projector: Floats = rig.pose @ calibration.pose.inverse() @ in_projector
    return rig.pose @ picture_corners(calibration.camera, depth), of_projector


def picture_corners(device: Intrinsics, depth: float) -> Floats:
    """The corners of a device's image at `depth` before it, (4, 3) in its frame: clockwise from the top left.

    Lens distortion is left out: straight lines stay straight, as in the picture of a frustum.
    """
    right, bottom = device.width - 0.5, device.height - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    rays = (corners - np.array(device.principal_point_px)) / np.array(device.focal_px)
    return depth * np.column_stack([rays, np.ones(4)])


def nice_step(length: float) -> float:
    """1, 2 or 5 times a power of ten, about a quarter of `length` > 0."""
    wanted = length / _TICKS_WANTED
    decade = 10.0 ** floor(log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * decade <= wanted * (1 + 1e-9)) * decade)


def ruler_lines(start: Floats, direction: Floats, across: Floats, length: float) -> Floats:
    """A ruler (n, 2, 3) from `start` along the unit vector `direction`, a tick along `across` at each nice step."""
    step = nice_step(length)
    at = start + np.arange(0, floor(length / step + 1e-9) + 1)[:, None] * step * direction
    ticks = np.stack([at, at + 0.25 * step * across], axis=1)
    return np.concatenate([np.stack([at[0], at[-1]])[None], ticks])


@dataclass(frozen=True)
class ScaleBar:
    """A bar of `width_px` pixels, which is as long as `text` says at the middle of the view."""

    width_px: float
    text: str


def scale_bar(px_per_unit: float, unit: str, density: int = 1) -> ScaleBar:
    """Return a bar of a round length; `px_per_unit` pixels are one of the cloud's unit, `density` one of the page."""
    length_unit = shown_unit(unit)
    step = nice_step(length_unit.factor * density * _WANTED_PX / px_per_unit)
    name = "baseline" if step == 1 and length_unit.name == "baselines" else length_unit.name
    return ScaleBar(step / length_unit.factor * px_per_unit, f"{step:g} {name}")


def scale_bar_html(bar: ScaleBar, height: int) -> str:
    """It, over the view, which is `height` of its pixels high and as high as the page."""
    text = escape(bar.text)
    return (
        f'<div class="scan-scale" role="img" aria-label="scale bar: {text}" title="At the middle of the view: what is '
        f'nearer looks larger"><div style="width: {100 * bar.width_px / height:.3f}vh"></div><p>{text}</p></div>'
    )


@dataclass(frozen=True)
class TextLabel:
    """A `text` at a `place` (3,) of the cloud's frame; `anchor` is the side of it that is there if there is room."""

    text: str
    place: Floats
    anchor: Anchor


def arranged(labels: Sequence[TextLabel], view: WindowView) -> tuple[Anchor | None, ...]:
    """The anchor of each label, so that none lies over another or is cut off; None for one that finds no room.

    The first have their choice first. A label that the window does not show is as it wants to be.
    """
    if not labels:
        return ()
    pixels, depths = view.project(np.stack([label.place for label in labels]))
    taken: list[Floats] = []
    anchors: list[Anchor | None] = []
    for label, pixel, depth in zip(labels, pixels, depths, strict=True):
        if depth <= 0 or np.any(pixel < 0) or np.any(pixel > (view.width, view.height)):
            anchors.append(label.anchor)
            continue
        inside = [
            (anchor, area)
            for anchor, area in _areas(label, pixel, view.density)
            if _is_inside(area, view) and not any(_overlap(area, taken_area) for taken_area in taken)
        ]
        anchors.append(inside[0][0] if inside else None)
        taken += [area for _, area in inside[:1]]
    return tuple(anchors)


def area_of(text: str, pixel: Floats, anchor: Anchor, density: int = 1) -> Floats:
    """Left, top, right and bottom of a label at a pixel, (4,)."""
    size = density * np.array([LETTER_PX * len(text) + _PADDING_PX, LINE_PX])
    vertical, horizontal = anchor.split("-")
    low = pixel - size * (_BEFORE[horizontal], _BEFORE[vertical])
    return np.concatenate([low, low + size])


def _areas(label: TextLabel, pixel: Floats, density: int) -> Iterator[tuple[Anchor, Floats]]:
    for anchor in dict.fromkeys((label.anchor, *_ANCHORS)):
        yield anchor, area_of(label.text, pixel, anchor, density)


def _overlap(first: Floats, second: Floats) -> bool:
    return bool(np.all(first[:2] < second[2:]) and np.all(second[:2] < first[2:]))


def _is_inside(area: Floats, view: WindowView) -> bool:
    return bool(np.all(area[:2] >= 0) and np.all(area[2:] <= (view.width, view.height)))
