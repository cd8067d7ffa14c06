"""A cloud in the browser: its points, the rigs that saw it, the faces, their vertex, and a ruler.

The surface of a capture as triangles for the browser, coloured like its points, reduced for smooth rotation.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil, sqrt
from pathlib import Path

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.numerics import Bools, Floats, Ints
from calib.pointcloud import SeenPoints, image_triangles
from scanner.exporting import Mesh, write_glb
from scanner.measuring import angle_cells
from scanner.quantities import device_names, shown_unit
from scanner.rendering import BLUE, FACE_COLOURS, VERMILION, frustum_lines
from scanner.viewing.colouring import Coloured, Colouring, coloured
from scanner.viewing.corner import MeasuredCorner
from scanner.viewing.crop import Box, whole
from scanner.viewing.geometry import (
    FRUSTUM_OF_SIZE,
    Anchor,
    TextLabel,
    frusta_of,
    nice_step,
    ruler_lines,
    typical_size,
)
from scanner.viewing.result import CaptureCloud, PlacedRig, ViewedCloud
from scanner.viewing.texts import angle_name
from scanner.viewing.windows import LABELS, PartKind, RoomPart, ShownCloud, Windows, rest_of, room_parts

_MOST_POINTS = 300_000
# The browser's camera is made for scenes of a few units, so clouds are scaled to this size.
_DRAWN_SIZE = 2.0
_FACE_OPACITY = 0.15
# Equally visible on white and dark pages.
_INK = (118, 118, 118)
_LINE_PX = 2.0
_POINT_OF_SIZE = 0.9
_BALL_OF_SIZE = 0.006

CLOUD, RIGS, FACES, PICKED, BOX = "/cloud", "/rigs", "/faces", "/picked", "/box"
PARTS = {kind: f"{CLOUD}/{kind.value}" for kind in PartKind}
_MESH, _POINTS = f"{CLOUD}/mesh", f"{CLOUD}/points"
_SEEN_THROUGH = 8  # one point in so many stays of a wall that is seen through


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles (T, 3) between points of a cloud, by number."""

    cloud: CaptureCloud
    triangles: Ints

    def glb(self, colours: NDArray[np.uint8], inside: Bools | None) -> tuple[bytes, int]:
        """Return the surface as binary glTF in the cloud's unit, y up, and its number of triangles.

        `colours` (N, 3) RGB; `inside` (N,): the points that it may connect.
        """
        kept = self.triangles if inside is None else self.triangles[np.all(inside[self.triangles], axis=1)]
        if not len(kept):
            return b"", 0
        used, corners = np.unique(kept, return_inverse=True)
        scan = self.cloud.scan
        triangles = corners.reshape(kept.shape).astype(np.int32)
        mesh = Mesh(scan.points[used], scan.normals[used], colours[used], triangles, scan.unit)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "mesh.glb")
            write_glb(path, mesh, 1.0)
            return path.read_bytes(), len(kept)


def surface_of(cloud: CaptureCloud) -> SurfaceMesh:
    """Triangles between neighbouring pixels, at every `step`th one of a large cloud."""
    scan = cloud.scan
    step = max(1, ceil(sqrt(len(scan) / _MOST_POINTS)))
    chosen = np.flatnonzero(np.all(scan.pixel % step == 0, axis=1))
    focal_px = float(np.mean(scan.calibration.camera.focal_px)) / step
    points = SeenPoints(scan.matches.camera_px[chosen] / step, scan.points[chosen], scan.normals[chosen], focal_px)
    triangles = image_triangles(points)
    return SurfaceMesh(cloud, chosen[triangles].astype(np.int32))


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
        self._parts: tuple[RoomPart, ...] = ()
        self._labels: list[TextLabel] = []
        self._drawn_points: list[viser.PointCloudHandle] = []
        self._scene.configure_default_lights(cast_shadow=False)
        self.windows = Windows(server)

    def clear(self) -> None:
        """Show nothing."""
        for name in (CLOUD, RIGS, FACES, LABELS, PICKED, BOX):
            self._scene.remove_by_name(name)
        self.windows.clear()
        self._cloud, self._parts, self._labels, self._drawn_points = None, (), [], []

    def show(self, cloud: ViewedCloud) -> None:
        """Draw everything about a cloud but its points, and look at it from a good place."""
        self.clear()
        self._cloud = cloud
        self._factor = _DRAWN_SIZE / typical_size(cloud)
        self._parts = room_parts(cloud)
        rests = (rest_of(PARTS[part.kind], number) for number, part in enumerate(self._parts))
        for parent in (CLOUD, RIGS, FACES, LABELS, *PARTS.values(), *rests):
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

    @property
    def kinds(self) -> set[PartKind]:
        """What of a room was recognised in the cloud."""
        return {part.kind for part in self._parts}

    def look(self) -> None:
        """Take all windows back to the first view."""
        if self._cloud is not None:
            walls = {rest_of(PARTS[part.kind], number): part for number, part in enumerate(self._parts)}
            self.windows.show(ShownCloud(self._cloud, self._factor, tuple(self._labels), walls))

    @contextmanager
    def enlarged(self, factor: float) -> Iterator[None]:
        """Points are drawn larger meanwhile: their size is in pixels, of which a larger picture has more."""
        sizes = [(points, points.point_size) for points in self._drawn_points]
        for points, size in sizes:
            points.point_size = factor * size
        try:
            yield
        finally:
            for points, size in sizes:
                points.point_size = size

    def draw_points(self, share: float, colouring: Colouring, box: Box) -> ViewSummary:
        """Draw a share of the cloud's points that are in the box, spread evenly."""
        cloud = self._required
        inside = cloud.order[box.holds(cloud.points)[cloud.order]] if box.bounded else cloud.order
        chosen = np.sort(inside[: max(1, round(share * len(inside)))])
        paint = coloured(cloud, chosen, colouring)
        self._scene.remove_by_name(_MESH)
        # The point size equals their spacing on surfaces that fill the view.
        size = _POINT_OF_SIZE * _DRAWN_SIZE / np.sqrt(max(share * len(cloud.points), 1))
        self._drawn_points = []
        for name, of_part in self._split(chosen):
            self._scene.remove_by_name(name)
            if of_part.any():
                points = self._scene.add_point_cloud(
                    name,
                    points=self._drawn(cloud.points[chosen[of_part]]),
                    colors=paint.colours[of_part],
                    point_size=size,
                    point_shape="circle",
                    point_shading="flat",
                    precision="float32",
                )
                self._drawn_points.append(points)
        return ViewSummary(len(chosen), len(inside), 0, paint)

    def _split(self, chosen: NDArray[np.int64]) -> Iterator[tuple[str, Bools]]:
        """Names of nodes, and which of the points (n,) each draws, (n,): those of walls apart from the others."""
        part_of = np.full(len(self._required.points), -1)
        for number, part in enumerate(self._parts):
            part_of[part.points] = number
        among = part_of[chosen]
        yield _POINTS, among < 0
        stays = np.random.default_rng(0).random(len(chosen)) < 1 / _SEEN_THROUGH
        for number, part in enumerate(self._parts):
            of_part = among == number
            yield f"{PARTS[part.kind]}/few {number}", of_part & stays
            yield f"{rest_of(PARTS[part.kind], number)}/points", of_part & ~stays

    def draw_surface(self, surface: SurfaceMesh, colouring: Colouring, box: Box) -> ViewSummary:
        """Draw the triangles in place of the points."""
        cloud = surface.cloud
        used = np.unique(surface.triangles).astype(np.int64)
        paint = coloured(cloud, used, colouring)
        colours = np.zeros((len(cloud.points), 3), np.uint8)
        colours[used] = paint.colours
        inside = box.holds(cloud.points) if box.bounded else None
        data, triangles = surface.glb(colours, inside)
        for points in self._drawn_points:
            points.remove()
        self._drawn_points = []
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
        """Show or hide `CLOUD`, `RIGS`, `FACES`, `LABELS` or one of `PARTS`."""
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
        depth = FRUSTUM_OF_SIZE * _DRAWN_SIZE / self._factor
        in_cloud, of_projector = frusta_of(rig, depth)
        of_camera = rig.pose.inverse() @ in_cloud
        centre = rig.projector_centre
        self._lines(f"{name}/camera", rig.pose @ frustum_lines(of_camera), BLUE)
        self._lines(f"{name}/projector", frustum_lines(of_projector - centre) + centre, VERMILION)
        self._lines(f"{name}/baseline", np.stack([rig.position, centre])[None], _INK)
        if rig.picture is not None:
            self._draw_picture(f"{name}/picture", rig, rig.picture, of_camera)
        self._label(names[0], rig.position, "bottom-right")
        self._label(names[1], centre, "bottom-left")

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
            self._label(f"Face {face.name}", outline.mean(axis=0), "center-center")
        ends = {face.name: outline for face, outline in zip(corner.scene.faces, outlines, strict=True)}
        for angle in corner.scene.angles:
            first, second = (ends[name] for name in angle.faces)
            text = f"{angle_name(angle.faces)}: {' '.join(angle_cells(angle))}"
            self._label(text, _end_of_common_edge(first, second), "center-center")
        self._label("Vertex", vertex, "bottom-center")
        self._scene.add_icosphere(f"{FACES}/vertex", 0.012 * _DRAWN_SIZE, color=_INK, position=self._drawn(vertex))

    def _draw_ruler(self, cloud: ViewedCloud) -> None:
        """Along the most level edge of the corner; without a corner, the baseline is labelled instead."""
        unit = shown_unit(cloud.unit)
        if cloud.corner is None:
            for rig in cloud.rigs[:1]:
                middle = rig.pose @ (rig.calibration.projector_centre / 2)
                self._label(unit.length(rig.calibration.baseline), middle, "top-center")
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
        self._label(text, vertex + place * edge, "top-center")

    def _lines(self, name: str, segments: Floats, colour: tuple[int, int, int]) -> None:
        points = self._drawn(segments)
        self._scene.add_line_segments(name, points, colour, thickness=_LINE_PX, thickness_units="screen")

    def _label(self, text: str, place: Floats, anchor: Anchor) -> None:
        self._labels.append(TextLabel(text, place, anchor))


def _end_of_common_edge(first: Floats, second: Floats) -> Floats:
    """Two thirds along the common edge of two outlines (4, 3), between their corners next to the vertex."""
    pairs = [(a, b) for a in (first[1], first[3]) for b in (second[1], second[3])]
    near = min(pairs, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))
    place: Floats = first[0] + 2 / 3 * ((near[0] + near[1]) / 2 - first[0])
    return place
