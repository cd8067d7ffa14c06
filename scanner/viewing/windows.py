"""What differs between browser windows on a scene: their views, the room for labels, walls before them, the scale.

Walls and the ceiling of a room in its cloud, which are seen through from outside.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from threading import Lock

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.numerics import Bools, Floats
from scanner.viewing.geometry import (
    FIELD_OF_VIEW_RAD,
    ScaleBar,
    TextLabel,
    Viewpoint,
    WindowView,
    arranged,
    density_of,
    scale_bar,
    scale_bar_html,
    viewpoint,
)
from scanner.viewing.result import ViewedCloud

_LEVEL, _DOWN = 0.2, -0.95  # of a wall's and a ceiling's normal, along the upright axis
_SECTORS = 12  # of directions that walls face
_THICK_OF_ROOM = 0.04  # what is closer to the outermost points of a wall belongs to it: pictures, no cupboards
_OUTERMOST = 0.02
_LEAST_SHARE = 0.01  # of the cloud's points
LABELS = "/labels"
_NARROW_PX, _UPRIGHT, _UNCOVERED = 576, 0.59, 0.55  # of phones, the panel covers the lower part (page.css)
_QUALITY = 85  # of JPEG
_STILL = 1e-3  # of the distance to the target: a window that has not been moved


class PartKind(StrEnum):
    """What can be seen through or left out."""

    WALL = "Walls"
    CEILING = "Ceiling"


@dataclass(frozen=True, eq=False)
class RoomPart:
    """A wall or the ceiling."""

    kind: PartKind
    normal: Floats
    """Into the room, (3,)."""
    offset: float
    """normal · X of its points."""
    points: NDArray[np.int64]
    """Their numbers in the cloud, (n,)."""

    def is_before(self, position: Floats) -> bool:
        """Whether who looks from `position` (3,) looks at its back."""
        return bool(self.normal @ position < self.offset)


def room_parts(cloud: ViewedCloud) -> tuple[RoomPart, ...]:
    """The walls, by the direction that they face, and the ceiling; none of a thing, whose sides face outwards."""
    if not cloud.has_walls or not np.any(cloud.normals):
        return ()
    up = cloud.up / np.linalg.norm(cloud.up)
    along_up = cloud.normals @ up
    inwards = np.einsum("ni,ni->n", cloud.normals, np.median(cloud.points, axis=0) - cloud.points) > 0
    first, second = _level_axes(up)
    facing = np.arctan2(cloud.normals @ second, cloud.normals @ first)
    walls = (np.abs(along_up) < _LEVEL) & inwards
    # Sectors have a wall in the middle, not at their edge, where most rooms have all four walls.
    turn = _common_turn(facing[walls])
    sector = np.rint((facing - turn) / (2 * np.pi / _SECTORS)).astype(np.int64) % _SECTORS
    sides = [_part(cloud, PartKind.WALL, walls & (sector == number)) for number in range(_SECTORS)]
    sides.append(_part(cloud, PartKind.CEILING, (along_up < _DOWN) & inwards))
    return tuple(part for part in sides if part is not None)


def _part(cloud: ViewedCloud, kind: PartKind, candidates: Bools) -> RoomPart | None:
    chosen = np.flatnonzero(candidates)
    if len(chosen) < max(1, _LEAST_SHARE * len(cloud.points)):
        return None
    normal = np.median(cloud.normals[chosen], axis=0)
    normal /= np.linalg.norm(normal)
    offsets = cloud.points[chosen] @ normal
    outermost = float(np.quantile(offsets, _OUTERMOST))
    along = cloud.points @ normal
    low, high = np.quantile(along, (0.01, 0.99))
    thick = _THICK_OF_ROOM * float(high - low)
    if outermost > low + 2 * thick:  # the front of a cupboard: there is more of the room behind it
        return None
    on = offsets < outermost + thick
    return RoomPart(kind, normal, outermost, chosen[on])


def _level_axes(up: Floats) -> tuple[Floats, Floats]:
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return first, np.cross(up, first)


def _common_turn(facing: Floats) -> float:
    """By how much walls that stand square to each other are turned, in radians."""
    return float(np.angle(np.sum(np.exp(4j * facing)))) / 4 if len(facing) else 0.0


def rest_of(parent: str, number: int) -> str:
    """The node of what is left out of a part that is seen through."""
    return f"{parent}/rest {number}"


@dataclass(frozen=True)
class ShownCloud:
    """A `cloud` in a scene, where it is `factor` times as large, with its `labels`; `walls` by the nodes of what is
    left out of each where it is seen through.
    """

    cloud: ViewedCloud
    factor: float
    labels: tuple[TextLabel, ...]
    walls: Mapping[str, RoomPart]


class Windows:
    """All windows of a server."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._lock = Lock()
        self._drawn: ShownCloud | None = None
        self._windows: dict[int, Window] = {}
        server.on_client_connect(self._add)
        server.on_client_disconnect(lambda client: self._windows.pop(client.client_id, None))

    def show(self, drawn: ShownCloud) -> None:
        """Look at it from a good place."""
        view = viewpoint(drawn.cloud)
        self._server.scene.set_up_direction(view.up)
        first = self._server.initial_camera
        first.up, first.fov = view.up, FIELD_OF_VIEW_RAD
        first.position, first.look_at = drawn.factor * view.position, drawn.factor * view.target
        with self._lock:
            self._drawn = drawn
            windows = list(self._windows.values())
        for window in windows:
            window.show(drawn)

    def clear(self) -> None:
        """Show no labels and no scale."""
        with self._lock:
            self._drawn = None
            windows = list(self._windows.values())
        for window in windows:
            window.clear()

    def paint(self, picture: "Callable[[Window], NDArray[np.uint8] | None]") -> None:
        """Fill each window that shows no cloud with its picture, (H, W, 3) RGB of the window's size; None for none."""
        with self._lock:
            windows = [] if self._drawn is not None else list(self._windows.values())
        for window in windows:
            window.paint(picture(window))

    def of(self, client: viser.ClientHandle) -> "Window | None":
        """That of a client."""
        return self._windows.get(client.client_id)

    def _add(self, client: viser.ClientHandle) -> None:
        with self._lock:
            window = self._windows[client.client_id] = Window(client)
            drawn = self._drawn
        if drawn is not None:
            window.show(drawn)
        client.camera.on_update(lambda _: window.follow())


class Window:
    """One window."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self.client = client
        self._lock = Lock()
        self._drawn: ShownCloud | None = None
        self._aimed: Viewpoint | None = None
        self._aspect = 0.0
        self._is_there = self._is_painted = False
        self._labels: list[viser.LabelHandle] = []
        self._walls: dict[str, viser.FrameHandle] = {}
        self._scale = client.gui.add_html("")

    @property
    def size(self) -> tuple[int, int]:
        """Its width and height, in pixels."""
        return self.client.camera.image_width, self.client.camera.image_height

    @property
    def free(self) -> tuple[int, int]:
        """The width and height of its part from the top left that no panel covers."""
        width, height = self.size
        return width, round(self._uncovered * height)

    @property
    def _uncovered(self) -> float:
        width, height = self.size
        is_phone = width < _NARROW_PX * self.density and width < _UPRIGHT * height
        return _UNCOVERED if is_phone else 1.0

    @property
    def density(self) -> int:
        """As of `WindowView`."""
        return density_of(self.client.camera.image_height)

    def paint(self, picture: NDArray[np.uint8] | None) -> None:
        """Fill it with a picture, unless it shows a cloud."""
        with self._lock:
            if self._drawn is None and (picture is not None or self._is_painted):
                self._is_painted = picture is not None
                self.client.scene.set_background_image(picture, "jpeg", jpeg_quality=_QUALITY)

    def show(self, drawn: ShownCloud) -> None:
        """Show everything, however narrow the window is."""
        with self._lock:
            self._remove()
            if self._is_painted:
                self._is_painted = False
                self.client.scene.set_background_image(None)
            self._drawn = drawn
            scene = self.client.scene
            self._labels = [
                scene.add_label(
                    f"{LABELS}/{number}", label.text, position=drawn.factor * label.place, anchor=label.anchor
                )
                for number, label in enumerate(drawn.labels)
            ]
            # A frame of the window's own takes the place of the scene's, with what is in it.
            self._walls = {name: scene.add_frame(name, show_axes=False) for name in drawn.walls}
            self._aim(drawn)

    def clear(self) -> None:
        """Show nothing of a cloud."""
        with self._lock:
            self._remove()

    def follow(self) -> None:
        """The window is looked through from elsewhere, or has another size."""
        with self._lock:
            drawn, aimed, camera = self._drawn, self._aimed, self.client.camera
            if drawn is None:
                return
            if aimed is not None:
                reach = drawn.factor * float(np.linalg.norm(aimed.position - aimed.target))
                off = np.linalg.norm(camera.position - drawn.factor * aimed.position)
                # An answer that is older than the view does not say that somebody has moved.
                if off < _STILL * reach:
                    self._is_there = True
                elif self._is_there:
                    self._aimed = None
                if self._aimed is not None and camera.aspect != self._aspect:
                    self._aim(drawn)
                    return
            self._arrange(drawn, self._view(drawn))

    @property
    def view(self) -> WindowView | None:
        """What it shows of the cloud, in the cloud's frame; None without one."""
        return None if self._drawn is None else self._view(self._drawn)

    @property
    def viewpoint(self) -> Viewpoint | None:
        """From where to where it looks, in the cloud's frame; None without a cloud."""
        drawn, camera = self._drawn, self.client.camera
        if drawn is None:
            return None
        return Viewpoint(camera.position / drawn.factor, camera.look_at / drawn.factor, camera.up_direction)

    def drawn_position(self, view: WindowView) -> Floats:
        """The position of a view in the scene, (3,)."""
        return view.position * (1.0 if self._drawn is None else self._drawn.factor)

    def scale_of(self, view: WindowView) -> ScaleBar:
        """The scale bar of a view, for the middle of it. Raises ValueError without a cloud."""
        if self._drawn is None:
            raise ValueError("without a cloud there is no scale")
        distance = float(np.linalg.norm(self.client.camera.look_at / self._drawn.factor - view.position))
        return scale_bar(view.focal_px / max(distance, np.finfo(np.float64).tiny), self._drawn.cloud.unit, view.density)

    def arrange(self, view: WindowView) -> None:
        """Have labels and walls as they have to be for a view."""
        with self._lock:
            if self._drawn is not None:
                self._arrange(self._drawn, view)

    def _view(self, drawn: ShownCloud) -> WindowView:
        camera = self.client.camera
        axes = Rotation.from_quat(camera.wxyz, scalar_first=True).as_matrix().T
        position = camera.position / drawn.factor
        return WindowView(position, axes, camera.fov, camera.image_width, camera.image_height)

    def _aim(self, drawn: ShownCloud) -> None:
        camera = self.client.camera
        self._aspect, self._is_there = camera.aspect, False
        view = self._aimed = viewpoint(drawn.cloud, camera.aspect, self._uncovered)
        with self.client.atomic():
            camera.up_direction = view.up
            camera.position = drawn.factor * view.position
            camera.look_at = drawn.factor * view.target
            camera.fov = FIELD_OF_VIEW_RAD
        self._arrange(drawn, WindowView.towards(view, FIELD_OF_VIEW_RAD, camera.image_width, camera.image_height))

    def _arrange(self, drawn: ShownCloud, view: WindowView) -> None:
        for handle, anchor in zip(self._labels, arranged(drawn.labels, view), strict=True):
            if anchor is not None and handle.anchor != anchor:
                handle.anchor = anchor
            if handle.visible != (anchor is not None):
                handle.visible = anchor is not None
        for name, frame in self._walls.items():
            behind = not drawn.walls[name].is_before(view.position)
            if frame.visible != behind:
                frame.visible = behind
        text = scale_bar_html(self.scale_of(view), view.height)
        if self._scale.content != text:
            self._scale.content = text

    def _remove(self) -> None:
        for handle in (*self._labels, *self._walls.values()):
            handle.remove()
        self._labels, self._walls = [], {}
        self._drawn = self._aimed = None
        self._scale.content = ""
