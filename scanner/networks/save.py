"""The files of a network: network.yaml, network.ply and the report."""

from pathlib import Path
from typing import Any

import numpy as np

from calib.geometry import Pose
from calib.numerics import Floats
from calib.pointcloud import MergedCloud, colours_of
from scanner.configuration import Config
from scanner.io import MATCHES_FILE, write_matches, write_room, write_room_ply
from scanner.networks.captures import folder_of
from scanner.networks.sights import PairProgress, network_graph
from scanner.networks.solve import SolvedNetwork
from scanner.networks.verdict import verdict_on
from scanner.quantities import shown_unit
from scanner.rendering import page, render, view_along
from scanner.reporting import (
    CAMERA_COLOUR,
    PROJECTOR_COLOUR,
    VIEWER,
    PageImage,
    Thinned,
    device_lines,
    extent_row,
    files_beside,
    looking,
    picture,
    turning_view,
)
from scanner.results import (
    CAPTURES_FOLDER,
    NETWORK,
    NETWORK_CLOUD_FILE,
    NETWORK_FILE,
    REPORT_FILE,
    Verdict,
    network_error_entries,
    provenance,
    verdict_entries,
)

_AHEAD, _UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
_VIEW = (960, 640)
_DEVICE_OF_SIZE = 0.05
_FRAME = "network frame: that of its first device, x right, y down, z ahead"


def save_network(network: SolvedNetwork, folder: Path, config: Config) -> Verdict:
    """Write everything, with the verdict, which is returned. Raises OSError."""
    verdict = verdict_on(network)
    entries = provenance(folder, config).entries({}) | verdict_entries(verdict) | entries_of(network)
    write_room(folder / NETWORK_FILE, entries)
    for number, station in enumerate(network.captures.stations):
        of_station = folder_of(folder / CAPTURES_FOLDER, number)
        for (camera, projector), capture in station.items():
            place = of_station / f"{camera}-{projector}"
            place.mkdir(parents=True, exist_ok=True)
            write_matches(place / MATCHES_FILE, capture.matches)
        if number:
            write_room_ply(of_station / NETWORK_CLOUD_FILE, cloud_of(network, number), _FRAME)
    cloud = cloud_of(network)
    write_room_ply(folder / NETWORK_CLOUD_FILE, cloud, _FRAME)
    _write_page(folder / REPORT_FILE, network, verdict, cloud, config)
    return verdict


def entries_of(network: SolvedNetwork) -> dict[str, Any]:
    """X_network = rotation X_device + translation; normal · X_network = offset."""
    estimate = network.estimate
    cameras = {camera for camera, _ in network.captures.decoded}
    devices = []
    for name in estimate.names:
        intrinsics, pose, sigma = estimate.intrinsics(name), estimate.device(name).pose, estimate.sigmas(name)
        devices.append(
            {
                "name": name,
                "kind": "camera" if name in cameras else "projector",
                "width": intrinsics.width,
                "height": intrinsics.height,
                "focal_px": list(intrinsics.focal_px),
                "principal_point_px": list(intrinsics.principal_point_px),
                "distortion": list(intrinsics.distortion),
                "rotation": pose.rotation.tolist(),
                "translation": (network.factor * pose.translation).tolist(),
                "sigma": {
                    "focal_px": [float(sigma[0]) * intrinsics.focal_px[0]] * 2,
                    "principal_point_px": sigma[1:3].tolist(),
                    "distortion": sigma[3:8].tolist(),
                    "rotation_deg": np.degrees(sigma[8:11]).tolist(),
                    "translation": (network.factor * sigma[11:]).tolist(),
                },
            }
        )
    planes = [
        {"normal": plane.normal.tolist(), "offset": network.factor * plane.offset} for plane in estimate.network.planes
    ]
    disagreements = [
        {
            "projector": projector,
            "cameras": [disagreement.first, disagreement.second],
            "relative": disagreement.relative,
            "expected": disagreement.expected,
            "points": disagreement.count,
        }
        for projector, surface in network.surfaces.items()
        for disagreement in surface.disagreements
    ]
    gains = {projector: surface.gain for projector, surface in network.surfaces.items() if np.isfinite(surface.gain)}
    of_surfaces = {"disagreements": disagreements, "sigma_gains": gains}
    of_devices = network_error_entries(estimate, network.factor, network.known)
    return {"unit": network.unit, "devices": devices, "planes": planes, **of_surfaces, **of_devices}


def cloud_of(network: SolvedNetwork, station: int = 0) -> MergedCloud:
    """All projectors' light at a station: each point once, by all cameras that saw it."""
    points, normals, colours = [], [], []
    decoded, surfaces = network.captures.stations[station], network.stations[station]
    for projector, surface in surfaces.items():
        there = np.isfinite(surface.points[..., 2])
        normal = _normals(surface.points, network.estimate.device(projector).pose.translation)
        colour = np.full((*there.shape, 3), 128, np.uint8)
        for camera, pixels in surface.seen_px.items():
            texture = decoded[camera, projector].texture
            if texture is None:
                continue
            known = np.isfinite(pixels[..., 0]) & there
            x, y = np.rint(pixels[known]).astype(np.int64).T
            with_texture = colours_of(texture, np.ones(texture.shape[:2], np.bool_))
            colour[known] = with_texture[y.clip(0, with_texture.shape[0] - 1), x.clip(0, with_texture.shape[1] - 1)]
        points.append(network.factor * surface.points[there])
        normals.append(normal[there])
        colours.append(colour[there])
    return MergedCloud(
        np.concatenate(points).astype(np.float32),
        np.concatenate(colours),
        np.concatenate(normals).astype(np.float32),
        network.unit,
        np.nan,
        (),
        (),
    )


def _normals(points: Floats, towards: Floats) -> Floats:
    """Of a grid (h, w, 3), to the side of `towards`; zero where neighbours are missing."""
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = normal / length * np.sign(np.sum(normal * (towards - points), axis=-1, keepdims=True))
    unit: Floats = np.nan_to_num(normal)
    return unit


def _write_page(path: Path, network: SolvedNetwork, verdict: Verdict, cloud: MergedCloud, config: Config) -> None:
    estimate, unit = network.estimate, shown_unit(network.unit)
    cameras = {camera for camera, _ in network.captures.decoded}
    rows = []
    for name in estimate.names:
        intrinsics, sigma = estimate.intrinsics(name), estimate.sigmas(name)
        place = network.factor * estimate.device(name).pose.translation
        rows.append(
            (
                name,
                "camera" if name in cameras else "projector",
                f"{intrinsics.focal_px[0]:.2f} ± {intrinsics.focal_px[0] * sigma[0]:.2g}",
                ", ".join(
                    f"{value:.1f} ± {s:.2g}" for value, s in zip(intrinsics.principal_point_px, sigma[1:3], strict=True)
                ),
                ", ".join(unit.number(value) for value in place.tolist()) + f" {unit.name}",
                "held" if name == estimate.names[0] else unit.error(network.factor * float(np.linalg.norm(sigma[11:]))),
            )
        )
    thinned = Thinned.of(cloud.points, cloud.colours, cloud.normals)
    length = _DEVICE_OF_SIZE * float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    lines = []
    for name in estimate.names:
        pose = estimate.device(name).pose
        pose = Pose(pose.rotation, network.factor * pose.translation)
        colour = CAMERA_COLOUR if name in cameras else PROJECTOR_COLOUR
        lines += device_lines(estimate.intrinsics(name), pose, length, colour, name)
    text = page(
        "network.html",
        runs=VIEWER,
        views=[_view(cloud)],
        view3d=turning_view(
            thinned,
            looking(_AHEAD, _UP, cloud.points),
            lines,
            network.unit,
        ),
        measured=[extent_row(cloud.points, network.unit, "x, y and z")],
        files=files_beside(path, NETWORK),
        verdict=verdict,
        provenance=provenance(path.parent, config),
        subtitle=", ".join(
            _counted(*counted)
            for counted in (
                (len(cameras), "camera"),
                (len(network.surfaces), "projector"),
                (len(cloud.points), "point"),
            )
        )
        + ".",
        devices=rows,
        walls=bool(estimate.network.planes),
        graph=network_graph([PairProgress.of(pair, capture) for pair, capture in network.captures.decoded.items()]),
        unit=network.unit,
    )
    path.write_text(text, encoding="utf-8")


def _view(cloud: MergedCloud) -> PageImage:
    drawn = render(cloud, view_along(np.array([0.5, 0.5, 1.0]), _UP), _VIEW, [])
    return picture(drawn, "the network's cloud, oblique view", caption="Obliquely from above.")


def _counted(number: int, noun: str) -> str:
    """A number of what `noun` names."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
