"""Readers of files, each as a function of the random numbers of one input."""

import io
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console

from calib.geometry import IDENTITY, Calibration, Pose
from tests.fuzz.guarded import MOST_CHARACTERS, Run, guarded
from tests.fuzz.mutations import Random, of_bytes, of_header, of_yaml


def capture(folder: Path) -> Run:
    """`capture.yaml`, and the decoder on frames that fit it."""
    from scanner.acquisition import decode
    from scanner.capture import identity, open_capture
    from scanner.patterns import sequence_for
    from scanner.ui import Terminal
    from tests.support.small_capture import SIZE, read_listing, write_capture

    write_capture(folder / "room", sequence_for(SIZE, cell=8, periods=(16.0,), shifts=3))
    listing = read_listing(folder / "room")
    listing |= {"devices": {"camera": "one", "projector": "two"}, "synchronisation": {"latency_ms": 3.2}}
    listing["frames"][1] |= {"exposure_us": 20000.0, "timestamp_ns": 10**18}
    terminal = Terminal(quiet=True)

    def read(rng: Random) -> None:
        (folder / "room" / "capture.yaml").write_bytes(of_yaml(listing, rng))
        recording = open_capture(folder / "room")
        assert sum(map(len, identity(recording.metadata).values())) < MOST_CHARACTERS
        decode([recording.stream()], terminal, "Decoding")

    return guarded(read)


def configuration(folder: Path) -> Run:
    """A configuration, reading its values, and setting a key in it."""
    from scanner.configuration import load_config, set_keys

    seeds = [yaml.safe_load(path.read_text()) for path in sorted(Path("configs").glob("*.yaml"))]

    def read(rng: Random) -> None:
        path = folder / "room.yaml"
        path.write_bytes(of_yaml(seeds[int(rng.integers(len(seeds)))], rng))
        config = load_config(path)
        config.principal_point(config.camera_size)
        list(config.sequence.patterns(config.projector_size))
        set_keys(path, {"rig.exposure_us": 12345.0})

    return guarded(read)


def calibration(folder: Path) -> Run:
    """`calibration.yaml`, also of OpenCV: numbers, uncertainty, and display."""
    from scanner.exporting import FORMATS, ExportRequest
    from scanner.io import read_calibration, write_calibration
    from scanner.quantities import calibration_table
    from scanner.results import COLUMNS, read_uncertainty, read_verdict
    from tests.support.cloud_scene import CAMERA, PROJECTOR

    path = folder / "calibration.yaml"
    write_calibration(path, Calibration(CAMERA, PROJECTOR, Pose(np.eye(3), np.array([0.4, 0.1, 0.0])), "m"))
    count = len(COLUMNS)
    seed = yaml.safe_load(path.read_text()) | {
        "sigma": {"camera_focal_px": 1.5, "rotation_deg": [0.1, 0.1, 0.2], "corner_angles_deg": 0.1},
        "verdict": {"grade": "good", "headline": "Well", "reasons": ["so"], "advice": ""},
        "covariance": {
            "columns": [*COLUMNS],
            "match_px": 0.05,
            "values": (1e-6 * np.eye(count)).tolist(),
            "along": {"probability": [0.5, 0.5], "steps": [[0.001] * count] * 2},
        },
    }
    FORMATS["opencv"].write(ExportRequest(folder, folder / "opencv.yaml", overwrite=True))
    of_opencv = (folder / "opencv.yaml").read_bytes()
    console = Console(file=io.StringIO())

    def read(rng: Random) -> None:
        is_opencv = rng.random() < 0.3
        path.write_bytes(of_bytes(of_opencv, rng) if is_opencv else of_yaml(seed, rng))
        found = read_calibration(path)
        if not is_opencv:
            read_verdict(path)
        read_uncertainty(path, found)
        console.print(calibration_table(found))

    return guarded(read)


def _npz(folder: Path, rng: Random) -> Path:
    """A matches file, plain or compressed, with unusual arrays, headers or bytes."""
    count = int(rng.integers(1, 40))
    arrays: dict[str, Any] = {
        "camera_px": rng.uniform(0, 400, (count, 2)),
        "projector_px": rng.uniform(0, 400, (count, 2)),
        "face": rng.integers(-1, 3, count),
        "sigma_px": rng.uniform(0.01, 1, count),
        "plane": rng.integers(-1, 5, count),
        "projector_measured": np.array([True, True]),
    }
    if rng.random() < 0.5:
        name = list(arrays)[int(rng.integers(len(arrays)))]
        kinds = ("<f2", ">f8", "<i8", "<u8", "?", "<c16", "<U3", "S5", "V7", "<M8[s]", "<f16", "<i1")
        with np.errstate(all="ignore"):
            arrays[name] = (arrays[name] * 10.0 ** rng.integers(-320, 308)).astype(kinds[int(rng.integers(len(kinds)))])
    path = folder / "matches.npz"
    methods = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    with zipfile.ZipFile(path, "w", methods[int(rng.integers(4))]) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, array, allow_pickle=False)
            content = member.getvalue()
            if rng.random() < 0.1:
                content = of_header(content, rng)
            if rng.random() < 0.1:
                shape = f"({rng.choice([10**3, 10**9, 10**18, -1])}, 2)".encode()
                content = re.sub(rb"\([0-9, ]+\)", shape, content, count=1)
            archive.writestr(f"{name}.npy", content)
    if rng.random() < 0.5:
        path.write_bytes(of_bytes(path.read_bytes(), rng))
    return path


def matches(folder: Path) -> Run:
    """`matches.npz`."""
    from scanner.io import read_matches, read_planes, refuse_one_axis

    def read(rng: Random) -> None:
        path = _npz(folder, rng)
        read_matches(path)
        read_planes(path)
        refuse_one_axis(path)

    return guarded(read)


def cloud(folder: Path) -> Run:
    """`cloud.ply`."""
    from scanner.io import read_cloud
    from tests.support.result_folder import write_result

    written = write_result(folder / "room", keep=lambda px: np.all(px % 24 < 1, axis=1, keepdims=False))
    path = written.folder / "cloud.ply"
    seed = path.read_bytes()
    cut = seed.index(b"end_header")

    def read(rng: Random) -> None:
        in_header = rng.random() < 0.7
        changed = of_bytes(seed[:cut], rng) + seed[cut:] if in_header else seed[:cut] + of_bytes(seed[cut:], rng)
        if rng.random() < 0.2:
            changed = re.sub(rb"vertex [0-9]+", b"vertex " + b"9" * int(2 ** rng.integers(14)), changed)
        path.write_bytes(changed)
        read_cloud(path)

    return guarded(read)


def surfaces(folder: Path) -> Run:
    """Clouds and meshes of other programs: text, PLY, PCD and OBJ."""
    from scanner.io import read_surface
    from tests.support.blob import Blob

    points, normals = Blob().cloud(60, 0)
    vertices, triangles = Blob().mesh(40)
    rows = "".join("{:.4f} {:.4f} {:.4f} 1 2 3\n".format(*row) for row in points)
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    binary = np.hstack([points, normals]).astype("<f4").tobytes()
    faces = "".join("f {}/1 {}/1 {}/1\n".format(*(1 + corners)) for corners in triangles)
    seeds = {
        "a.xyz": f"x;y;z;r;g;b\n{rows.replace(' ', ';').replace('.', ',')}".encode(),
        "a.pts": f"60\n{rows}".encode(),
        "a.ply": f"ply\nformat binary_little_endian 1.0\nelement vertex 60\n{properties}end_header\n".encode() + binary,
        "b.ply": f"ply\nformat ascii 1.0\nelement vertex 60\n{properties}end_header\n{rows}".encode(),
        "a.pcd": f"FIELDS x y z rgb\nCOUNT 1 1 1 3\nPOINTS 60\nDATA ascii\n{rows}".encode(),
        "a.obj": "".join("v {:.4f} {:.4f} {:.4f}\n".format(*row) for row in vertices).encode() + faces.encode(),
    }

    def read(rng: Random) -> None:
        name = sorted(seeds)[int(rng.integers(len(seeds)))]
        seed, cut = seeds[name], int(rng.choice([0, 120]))
        (folder / name).write_bytes(of_bytes(seed[:cut], rng) + seed[cut:] if cut else of_bytes(seed, rng))
        found = read_surface(folder / name)
        assert np.isfinite(found.points).all()

    return guarded(read)


def poses(folder: Path) -> Run:
    """`poses.yaml`."""
    from calib.diagnostics import PoseErrors
    from calib.refinement import SHARED
    from scanner.io import read_poses, write_poses
    from scanner.results import pose_error_entries, read_pose_errors

    path = folder / "poses.yaml"
    errors, direction = PoseErrors(np.eye(12), np.zeros((12, SHARED))), np.array([1.0, 0.0, 0.0])
    write_poses(path, [IDENTITY, IDENTITY], pose_error_entries(errors, direction))
    seed = yaml.safe_load(path.read_text())

    def read(rng: Random) -> None:
        path.write_bytes(of_yaml(seed, rng))
        read_poses(path, 2)
        read_pose_errors(path, 2, direction)

    return guarded(read)


def room(folder: Path) -> Run:
    """`room.yaml`."""
    from scanner.io import read_room, write_room

    path = folder / "room.yaml"
    station = {"rotation": np.eye(3).tolist(), "translation": [0.0, 1.0, 2.0]}
    stations = [{"name": f"station {n}", "folder": f"captures/{n}", **station} for n in (1, 2)]
    write_room(path, {"unit": "m", "stations": stations, "planes": [{"normal": [0.0, 0.0, 1.0], "offset": 0.0}]})
    seed = yaml.safe_load(path.read_text())

    def read(rng: Random) -> None:
        path.write_bytes(of_yaml(seed, rng))
        read_room(path)

    return guarded(read)


def network(folder: Path) -> Run:
    """`network.yaml`."""
    from scanner.io import read_network
    from tests.support.mapped_room import write_network

    path = write_network(folder / "hall", np.random.default_rng(0)) / "network.yaml"
    seed = yaml.safe_load(path.read_text())

    def read(rng: Random) -> None:
        path.write_bytes(of_yaml(seed, rng))
        read_network(path)

    return guarded(read)


def steps(folder: Path) -> Run:
    """`steps.yaml`, and the steps on a cloud."""
    from scanner.cleaning import read_cleaned
    from tests.support.result_folder import write_result

    write_result(folder / "room", keep=lambda pixel: np.all(pixel % 6 == 0, axis=1))
    box = "-1,-1,0,1,1,3"
    seed = {
        "steps": [
            {"box": box},
            {"outliers": 2.5},
            {"pieces": "5cm"},
            {"smooth": True},
            {"floor": True},
            {"axes": "0,0,0,1,0,0,0,1,0"},
            {"box": f"{box},0,0,0,1,0,0,0,1,0"},
            {"fill": 0.05},
            {"triangles": 500},
        ]
    }

    def read(rng: Random) -> None:
        (folder / "room" / "steps.yaml").write_bytes(of_yaml(seed, rng))
        read_cleaned(folder / "room").cloud()

    return guarded(read)


def imports(folder: Path) -> Run:
    """Folders of other programs: file names, and the files beside the frames."""
    from scanner.importing import LAYOUTS, find_frames

    names = ["cap_001.png", "cap_002.png", "cap_10.png", "white.png", "12.jpg", "a1b2.tif"]
    texts = {
        "projector_info.txt": b"1024 768",
        "config.xml": b"<disp_width>640</disp_width><disp_height>360</disp_height><step>80</step>",
    }

    def read(rng: Random) -> None:
        place = folder / "frames"
        place.mkdir()
        try:
            for name in names:
                changed = of_bytes(name.encode(), rng) if rng.random() < 0.5 else name.encode()
                usable = changed.replace(b"/", b"").replace(b"\0", b"")[:200]
                if usable not in (b"", b".", b".."):
                    (place / usable.decode("utf-8", errors="surrogateescape")).touch()
            for name, text in texts.items():
                long = text.replace(b"6", b"6" * 5000) if rng.random() < 0.1 else text
                (place / name).write_bytes(of_bytes(long, rng))
            for layout in LAYOUTS:
                layout.settings(place)
            str(find_frames(place))
        finally:
            for path in place.iterdir():
                path.unlink()
            place.rmdir()

    return guarded(read)
