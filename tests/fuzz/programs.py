"""Whole pipelines on well-formed numbers and files of impossible scenes."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console

from tests.fuzz.guarded import Run, guarded
from tests.fuzz.mutations import Random, extreme


def results(folder: Path) -> Run:
    """A result with extreme but well-formed numbers: read, measured, shown and exported."""
    from calib.pointcloud import build_cloud
    from scanner.exporting import FORMATS, ExportRequest
    from scanner.io import read_calibration, write_ply
    from scanner.measuring import measure, read_scene, tables
    from scanner.results import COLUMNS, read_finished_scan
    from scanner.viewing import ViewedResult
    from tests.support.result_folder import write_result

    written = write_result(folder / "room", keep=lambda px: np.all(px % 16 < 1, axis=1, keepdims=False))
    path = written.folder / "calibration.yaml"
    covariance = {"columns": [*COLUMNS], "match_px": 0.05, "values": (1e-6 * np.eye(len(COLUMNS))).tolist()}
    seed = yaml.safe_load(path.read_text()) | {"covariance": covariance, "sigma": {"known_baseline": 0.001}}
    console = Console(file=io.StringIO())

    def read(rng: Random) -> None:
        changed = yaml.safe_load(yaml.safe_dump(seed))
        for _ in range(int(rng.integers(1, 4))):
            device = changed["camera" if rng.random() < 0.5 else "projector"]
            match int(rng.integers(5)):
                case 0:
                    device["focal_px"][int(rng.integers(2))] = abs(extreme(300.0, rng))
                case 1:
                    device["principal_point_px"][int(rng.integers(2))] = extreme(200.0, rng)
                case 2:
                    device["distortion"][int(rng.integers(5))] = extreme(0.05, rng)
                case 3:
                    changed["translation"] = [extreme(number, rng) for number in changed["translation"]]
                case _:
                    row = changed["covariance"]["values"][int(rng.integers(len(COLUMNS)))]
                    row[int(rng.integers(len(row)))] = extreme(1e-6, rng)
        path.write_text(yaml.safe_dump(changed))
        found = read_calibration(path)
        built = build_cloud(written.scene.matches, written.scene.texture, found)
        write_ply(written.folder / "cloud.ply", built, match=built.match)
        if rng.random() < 0.3:
            _spoil_normals(written.folder / "cloud.ply", rng)
        scan = read_finished_scan(written.folder)
        measured = measure(scan, read_scene(written.folder, found), [])
        for table in tables(measured):
            console.print(table)
        ViewedResult(written.folder).cloud("The capture")
        for name in ("opencv", "colmap", "ply", "mesh"):
            out = folder / f"out{FORMATS[name].ending}"
            FORMATS[name].write(ExportRequest(written.folder, out, True, 100))

    return guarded(read)


def _spoil_normals(path: Path, rng: Random) -> None:
    """Some normals of a cloud are missing or have an impossible length."""
    header, end, body = path.read_bytes().partition(b"end_header\n")
    vertices = np.frombuffer(bytearray(body), np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rest", "V7")]))
    chosen = rng.random(len(vertices)) < rng.choice([0.01, 1.0])
    vertices["normal"][chosen] = rng.choice([np.nan, np.inf, 3e38, 0.0])
    path.write_bytes(header + end + vertices.tobytes())


def calibrating(folder: Path) -> Run:
    """Matches → faces → calibration → cloud, on well-formed numbers of no room."""
    from calib.geometry import Matches
    from calib.pointcloud import build_cloud
    from scanner.capture import CaptureMetadata
    from scanner.configuration import Config
    from scanner.reconstruction import calibrate, label
    from scanner.results import Decoded, GivenMatches
    from tests.support.cloud_scene import CAMERA, PROJECTOR, room

    del folder
    whole = room().matches

    def read(rng: Random) -> None:
        chosen = rng.permutation(len(whole))[: int(rng.choice([3, 30, 300, 1000]))]
        some = whole[np.sort(chosen)]
        camera_px, projector_px, face = some.camera_px.copy(), some.projector_px.copy(), some.labels.copy()
        sigma: Any = None
        for _ in range(int(rng.integers(1, 4))):
            pixels = camera_px if rng.random() < 0.5 else projector_px
            part = rng.random(len(face)) < rng.choice([0.01, 0.5, 1.0])
            match int(rng.integers(9)):
                case 0:
                    pixels[part] = pixels[0]
                case 1:
                    pixels[part, int(rng.integers(2))] = 100.0
                case 2:
                    pixels[part] = np.round(pixels[part] / 64) * 64
                case 3:
                    pixels[part] = pixels[part][:, ::-1]
                case 4:
                    face[part] = int(rng.integers(-1, 3))
                case 5:
                    pixels[part] = rng.uniform(0, 400, (int(part.sum()), 2))
                case 6:
                    sigma = 10.0 ** rng.uniform(-9, 6, len(face))
                case 7:
                    pixels[part] *= 1e-9
                case _:
                    projector_px[part] = camera_px[part]
        labelled = None if rng.random() < 0.2 else face
        metadata = CaptureMetadata(CAMERA.size, PROJECTOR.size)
        given = Decoded(metadata, Matches(camera_px, projector_px, labelled, sigma), GivenMatches(None), "fuzzed")
        config = Config(method="paper") if rng.random() < 0.2 else Config()
        for found in calibrate(label([given], [given], config), config):
            build_cloud(found.decoded.matches, None, found.calibration)

    return guarded(read)
