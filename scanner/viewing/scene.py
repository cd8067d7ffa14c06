"""A cloud in the browser: its points, the rigs that saw it, the faces, their vertex, and a ruler."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.numerics import Floats
from scanner.measuring import angle_cells
from scanner.quantities import device_names, shown_unit
from scanner.rendering import BLUE, FACE_COLOURS, VERMILION, frustum_lines
from scanner.viewing.colouring import Coloured, Colouring, coloured
from scanner.viewing.corner import MeasuredCorner
from scanner.viewing.crop import Box, whole
from scanner.viewing.geometry import (
    FIELD_OF_VIEW_RAD,
    nice_step,
    picture_corners,
    ruler_lines,
    typical_size,
    viewpoint,
)
from scanner.viewing.result import PlacedRig, ViewedCloud
from scanner.viewing.surface import SurfaceMesh
from scanner.viewing.texts import angle_name

# The browser's camera is made for scenes of a few units, so clouds are scaled to this size.
_DRAWN_SIZE = 2.0
_FRUSTUM_OF_SIZE = 0.25
_FACE_OPACITY = 0.15
# Equally visible on white and dark pages.
_INK = (118, 118, 118)
_LINE_PX = 2.0
_POINT_OF_SIZE = 0.9
_BALL_OF_SIZE = 0.006

CLOUD, RIGS, FACES, LABELS, PICKED, BOX = "/cloud", "/rigs", "/faces", "/labels", "/picked", "/box"
_MESH = f"{CLOUD}/mesh"


@dataclass(frozen=True)
class ViewSummary:
    """The current view: how many `points` of how many in the box, or how many triangles, and the meaning of the
    colours.
    """

    points: int
    among: int
    triangles: int
    coloured: Coloured


class CloudScene:
    """The 3-D scene of one or several browser windows."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._scene = server.scene
        self._cloud: ViewedCloud | None = None
        self._factor = 1.0
        self._scene.configure_default_lights(cast_shadow=False)
        server.on_client_connect(self._aim)

    def clear(self) -> None:
        """Show nothing."""
        for name in (CLOUD, RIGS, FACES, LABELS, PICKED, BOX):
            self._scene.remove_by_name(name)
        self._cloud = None

    def show(self, cloud: ViewedCloud) -> None:
        """Draw everything about a cloud but its points, and look at it from a good place."""
        self.clear()
        self._cloud = cloud
        self._factor = _DRAWN_SIZE / typical_size(cloud)
        for parent in (CLOUD, RIGS, FACES, LABELS):
            self._scene.add_frame(parent, show_axes=False)
        for number, rig in enumerate(reversed(cloud.rigs), start=1):
            first, second = device_names(rig.calibration, number, len(cloud.rigs))
            self._draw_rig(f"{RIGS}/{number}", rig, rig.names or (first.capitalize(), second.capitalize()))
        if cloud.corner is not None:
            self._draw_corner(cloud.corner, cloud.rigs[0])
        self._draw_ruler(cloud)
        self.look()

    def follow(self, cloud: ViewedCloud, colouring: Colouring) -> ViewSummary:
        """Draw another cloud's points in place of the last one's, from where everybody looks now."""
        self._cloud = replace(cloud, rigs=self._required.rigs)
        return self.draw_points(1.0, colouring, whole(cloud))

    def look(self) -> None:
        """Take all windows back to the first view."""
        if self._cloud is None:
            return
        view = viewpoint(self._cloud)
        self._scene.set_up_direction(view.up)
        first = self._server.initial_camera
        first.up, first.fov = view.up, FIELD_OF_VIEW_RAD
        first.position, first.look_at = self._drawn(view.position), self._drawn(view.target)
        for client in self._server.get_clients().values():
            self._aim(client)

    def _aim(self, client: viser.ClientHandle) -> None:
        """Have a window show everything, however narrow it is."""
        if self._cloud is None:
            return
        view = viewpoint(self._cloud, client.camera.aspect)
        with client.atomic():
            client.camera.up_direction = view.up
            client.camera.position = self._drawn(view.position)
            client.camera.look_at = self._drawn(view.target)
            client.camera.fov = FIELD_OF_VIEW_RAD

    def draw_points(self, share: float, colouring: Colouring, box: Box) -> ViewSummary:
        """Draw a share of the cloud's points that are in the box, spread evenly."""
        cloud = self._required
        inside = cloud.order[box.holds(cloud.points)[cloud.order]] if box.bounded else cloud.order
        chosen = np.sort(inside[: max(1, round(share * len(inside)))])
        paint = coloured(cloud, chosen, colouring)
        self._scene.remove_by_name(_MESH)
        self._scene.add_point_cloud(
            f"{CLOUD}/points",
            points=self._drawn(cloud.points[chosen]),
            colors=paint.colours,
            # The point size equals their spacing on surfaces that fill the view.
            point_size=_POINT_OF_SIZE * _DRAWN_SIZE / np.sqrt(max(share * len(cloud.points), 1)),
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )
        return ViewSummary(len(chosen), len(inside), 0, paint)

    def draw_surface(self, surface: SurfaceMesh, colouring: Colouring, box: Box) -> ViewSummary:
        """Draw the triangles in place of the points."""
        cloud = surface.cloud
        used = np.unique(surface.triangles).astype(np.int64)
        paint = coloured(cloud, used, colouring)
        colours = np.zeros((len(cloud.points), 3), np.uint8)
        colours[used] = paint.colours
        inside = box.holds(cloud.points) if box.bounded else None
        data, triangles = surface.glb(colours, inside)
        self._scene.remove_by_name(f"{CLOUD}/points")
        self._scene.remove_by_name(_MESH)
        if triangles:
            # Rotated from glTF's y up to the camera's y down.
            self._scene.add_glb(_MESH, data, scale=self._factor, wxyz=(0.0, 1.0, 0.0, 0.0))
        return ViewSummary(0, 0, triangles, paint)

    def draw_box(self, box: Box) -> None:
        """Draw its edges, if it has a wall."""
        self._scene.remove_by_name(BOX)
        if box.bounded:
            self._lines(BOX, box.edges, _INK)

    def on_click(self, picked: Callable[[Floats, Floats], None]) -> None:
        """Call `picked` with the origin and the direction of each click's ray in the cloud's frame, (3,) each."""

        def clicked(event: viser.SceneClickEvent) -> None:
            picked(np.array(event.ray_origin) / self._factor, np.array(event.ray_direction))

        self._scene.on_click()(clicked)

    def draw_picked(self, places: Floats) -> None:
        """Mark points (n, 3) that were clicked on, joined by a line in their order, in place of the last ones."""
        self._scene.remove_by_name(PICKED)
        self._scene.add_frame(PICKED, show_axes=False)
        for number, place in enumerate(places):
            ball = f"{PICKED}/{number}"
            self._scene.add_icosphere(ball, _BALL_OF_SIZE * _DRAWN_SIZE, color=VERMILION, position=self._drawn(place))
        if len(places) > 1:
            self._lines(f"{PICKED}/line", np.stack([places[:-1], places[1:]], axis=1), VERMILION)

    def set_visible(self, part: str, visible: bool) -> None:
        """Show or hide `CLOUD`, `RIGS`, `FACES` or `LABELS`."""
        handle = self._scene.get_handle_by_name(part)
        if handle is not None:
            handle.visible = visible

    @property
    def _required(self) -> ViewedCloud:
        if self._cloud is None:
            raise ValueError("there is no cloud to draw points of")
        return self._cloud

    def _drawn(self, points: Floats) -> NDArray[np.float32]:
        return (self._factor * points).astype(np.float32)

    def _draw_rig(self, name: str, rig: PlacedRig, names: tuple[str, str]) -> None:
        calibration = rig.calibration
        depth = _FRUSTUM_OF_SIZE * _DRAWN_SIZE / self._factor
        of_camera = picture_corners(calibration.camera, depth)
        in_projector = picture_corners(calibration.projector, depth)
        centre = rig.projector_centre
        of_projector = rig.pose @ calibration.pose.inverse() @ in_projector
        self._lines(f"{name}/camera", rig.pose @ frustum_lines(of_camera), BLUE)
        self._lines(f"{name}/projector", frustum_lines(of_projector - centre) + centre, VERMILION)
        self._lines(f"{name}/baseline", np.stack([rig.position, centre])[None], _INK)
        if rig.picture is not None:
            self._draw_picture(f"{name}/picture", rig, rig.picture, of_camera)
        for label, place, anchor in zip(names, (rig.position, centre), ("bottom-right", "bottom-left"), strict=True):
            self._label(f"{LABELS}/{label}", label, place, anchor)

    def _draw_picture(self, name: str, rig: PlacedRig, picture: NDArray[np.uint8], corners: Floats) -> None:
        """The camera's picture where its frustum ends; a picture lies in its own x, y plane, y down."""
        width, height = corners[2, :2] - corners[0, :2]
        self._scene.add_image(
            name,
            picture,
            render_width=float(self._factor * width),
            render_height=float(self._factor * height),
            wxyz=Rotation.from_matrix(rig.pose.rotation).as_quat(scalar_first=True),
            position=self._drawn(rig.pose @ corners.mean(axis=0)),
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_corner(self, corner: MeasuredCorner, rig: PlacedRig) -> None:
        vertex = rig.pose @ corner.corner.vertex
        outlines = rig.pose @ corner.outlines
        for face, outline, colour in zip(corner.scene.faces, outlines, FACE_COLOURS, strict=True):
            self._scene.add_mesh_simple(
                f"{FACES}/{face.name}",
                vertices=self._drawn(outline),
                faces=np.array([[0, 1, 2], [0, 2, 3]]),
                color=colour,
                opacity=_FACE_OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._lines(f"{FACES}/outline {face.name}", np.stack([outline, np.roll(outline, -1, axis=0)], 1), colour)
            self._label(f"{LABELS}/face {face.name}", f"Face {face.name}", outline.mean(axis=0), "center-center")
        ends = {face.name: outline for face, outline in zip(corner.scene.faces, outlines, strict=True)}
        for angle in corner.scene.angles:
            first, second = (ends[name] for name in angle.faces)
            text = f"{angle_name(angle.faces)}: {' '.join(angle_cells(angle))}"
            self._label(f"{LABELS}/{text}", text, _end_of_common_edge(first, second), "center-center")
        self._label(f"{LABELS}/vertex", "Vertex", vertex, "bottom-center")
        self._scene.add_icosphere(f"{FACES}/vertex", 0.012 * _DRAWN_SIZE, color=_INK, position=self._drawn(vertex))

    def _draw_ruler(self, cloud: ViewedCloud) -> None:
        """Along the most level edge of the corner; without a corner, the baseline is labelled instead."""
        unit = shown_unit(cloud.unit)
        if cloud.corner is None:
            for rig in cloud.rigs[:1]:
                middle = rig.pose @ (rig.calibration.projector_centre / 2)
                self._label(f"{LABELS}/ruler", unit.length(rig.calibration.baseline), middle, "top-center")
            return
        rig = cloud.rigs[0]
        legs = rig.pose.rotate(cloud.corner.corner.legs)
        level = int(np.argmin(np.abs(legs @ cloud.up)))
        edge, across = legs[level], legs[(level + 1) % 3]
        vertex = rig.pose @ cloud.corner.corner.vertex
        reach = float(np.max((rig.pose @ cloud.corner.outlines - vertex) @ edge))
        lines = ruler_lines(vertex, edge, across, reach)
        self._lines(f"{FACES}/ruler", lines, _INK)
        step = nice_step(reach)
        text = f"{unit.factor * step:g} {unit.name}"
        # Next to a tick near the edge's middle, because its ends carry a name and an angle.
        place = (max(0, round(reach / (2 * step) - 0.5)) + 0.5) * step
        self._label(f"{LABELS}/ruler", text, vertex + place * edge, "top-center")

    def _lines(self, name: str, segments: Floats, colour: tuple[int, int, int]) -> None:
        points = self._drawn(segments)
        self._scene.add_line_segments(name, points, colour, thickness=_LINE_PX, thickness_units="screen")

    def _label(self, name: str, text: str, position: Floats, anchor: Any) -> None:
        self._scene.add_label(name, text, position=self._drawn(position), anchor=anchor)


def _end_of_common_edge(first: Floats, second: Floats) -> Floats:
    """Two thirds along the common edge of two outlines (4, 3), between their corners next to the vertex."""
    pairs = [(a, b) for a in (first[1], first[3]) for b in (second[1], second[3])]
    near = min(pairs, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))
    place: Floats = first[0] + 2 / 3 * ((near[0] + near[1]) / 2 - first[0])
    return place
