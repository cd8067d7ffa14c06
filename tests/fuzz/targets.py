"""Every reader of the program, each as a function that takes the random numbers of one input and does all with it.

What may come of it is a result, or one of our own errors, with a message that fits a screen and that a terminal shows
rather than obeys: `RejectedError`. Anything else is a finding.
"""

import io
import os
import re
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from PIL import Image, TiffImagePlugin
from rich.console import Console

from calib.geometry import Calibration
from calib.refusal import RefusalError
from scanner.errors import InputError
from scanner.ui import failure_of
from tests.fuzz.mutations import Random, extreme, of_bytes, of_header, of_yaml

_Run = Callable[[Random], None]
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_MOST_LINES, _MOST_CHARACTERS = 100, 20_000


class RejectedError(Exception):
    """One of our errors, as it should be."""


def rng_of(seed: int, number: int) -> Random:
    """The random numbers of one input."""
    return np.random.default_rng([seed, number])


def _guarded(read: _Run) -> _Run:
    """The same, whose own errors are looked at: what they say is what a person sees."""

    def run(rng: Random) -> None:
        try:
            read(rng)
        except (InputError, RefusalError) as error:
            message = failure_of(error).message
            assert not _OBEYED.search(message), f"a terminal obeys {message!r}"
            assert message.count("\n") < _MOST_LINES, "longer than a screen"
            assert len(message) < _MOST_CHARACTERS, "longer than a screen"
            raise RejectedError from error

    return run


def _size(width: int, height: int) -> dict[str, int]:
    return {"width": width, "height": height}


def capture(folder: Path) -> _Run:
    """`capture.yaml`, and with frames that fit it the decoder."""
    from scanner.capture import identity, open_capture
    from scanner.patterns import sequence_for
    from scanner.pipeline import decode
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
        assert sum(map(len, identity(recording.metadata).values())) < _MOST_CHARACTERS
        decode(recording.stream(), terminal, "Decoding")

    return _guarded(read)


def configuration(folder: Path) -> _Run:
    """A configuration, what it is asked for, and a key set in it."""
    from scanner.configuration import load_config, set_keys

    seeds = [yaml.safe_load(path.read_text()) for path in sorted(Path("configs").glob("*.yaml"))]

    def read(rng: Random) -> None:
        path = folder / "room.yaml"
        path.write_bytes(of_yaml(seeds[int(rng.integers(len(seeds)))], rng))
        config = load_config(path)
        config.principal_point(config.camera_size)
        list(config.sequence.patterns(config.projector_size))
        set_keys(path, {"rig.exposure_us": 12345.0})

    return _guarded(read)


def calibration(folder: Path) -> _Run:
    """`calibration.yaml`: the numbers, what they are worth, and how they are shown."""
    from scanner.io import read_calibration, write_calibration
    from scanner.quantities import calibration_table
    from scanner.results import read_uncertainty, read_verdict
    from scanner.results.stated_uncertainty import COLUMNS
    from tests.support.cloud_scene import CAMERA, PROJECTOR

    path = folder / "calibration.yaml"
    write_calibration(path, Calibration(CAMERA, PROJECTOR, np.eye(3), np.array([0.4, 0.1, 0.0]), "m"))
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
    console = Console(file=io.StringIO())

    def read(rng: Random) -> None:
        path.write_bytes(of_yaml(seed, rng))
        found = read_calibration(path)
        read_verdict(path)
        read_uncertainty(path, found)
        console.print(calibration_table(found))

    return _guarded(read)


def _npz(folder: Path, rng: Random) -> Path:
    """A matches file, whole or compressed, with odd arrays, headers or bytes."""
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


def matches(folder: Path) -> _Run:
    """`matches.npz`."""
    from scanner.io import read_matches, read_planes, refuse_one_axis

    def read(rng: Random) -> None:
        path = _npz(folder, rng)
        read_matches(path)
        read_planes(path)
        refuse_one_axis(path)

    return _guarded(read)


def _picture(rng: Random, channels: int, dtype: Any) -> Any:
    rough = rng.integers(0, 256, (70, 90, channels)).astype(np.uint8)
    smooth = cv2.GaussianBlur(rough, (0, 0), 2).reshape(70, 90, channels)
    return (smooth.astype(dtype) * (257 if dtype == np.uint16 else 1)).squeeze()


def _encoded(suffix: str) -> list[bytes]:
    rng = np.random.default_rng(0)
    found = []
    for channels in (1, 3, 4):
        for dtype in (np.uint8, np.uint16):
            try:
                done, data = cv2.imencode(suffix, _picture(rng, channels, dtype))
            except cv2.error:
                continue
            found += [data.tobytes()] if done else []
    return found + [encode(_picture(rng, 3, np.uint8)) for encode in _PILLOW.get(suffix, ())]


def _by_pillow(kind: str, mode: str, **options: Any) -> Callable[[Any], bytes]:
    def encode(pixels: Any) -> bytes:
        stream = io.BytesIO()
        Image.fromarray(pixels).convert(mode).save(stream, kind, **options)
        return stream.getvalue()

    return encode


_PILLOW: dict[str, tuple[Callable[[Any], bytes], ...]] = {
    ".png": (_by_pillow("PNG", "P"), _by_pillow("PNG", "1"), _by_pillow("PNG", "LA")),
    ".jpg": (_by_pillow("JPEG", "RGB", progressive=True), _by_pillow("JPEG", "CMYK")),
    ".tif": tuple(
        _by_pillow("TIFF", mode, compression=compression)
        for mode, compression in (("RGB", None), ("RGB", "tiff_adobe_deflate"), ("L", "packbits"), ("1", "group4"))
    ),
    ".webp": (_by_pillow("WEBP", "RGB", lossless=True),),
    ".gif": (_by_pillow("GIF", "P"),),
    ".ppm": (_by_pillow("PPM", "RGB"), _by_pillow("PPM", "1")),
}


def image(suffix: str) -> Callable[[Path], _Run]:
    """Images of one format."""

    def target(folder: Path) -> _Run:
        from scanner.io import read_image

        seeds = _encoded(suffix)
        assert seeds, f"nothing here writes {suffix}"
        path = folder / f"frame{suffix}"

        def read(rng: Random) -> None:
            path.write_bytes(of_header(seeds[int(rng.integers(len(seeds)))], rng))
            read_image(path)

        return _guarded(read)

    return target


def masks(folder: Path) -> _Run:
    """Three masks, one of them changed."""
    from calib.geometry import Size
    from scanner.reconstruction import read_masks

    whole = []
    for index in range(3):
        pixels = np.zeros((31, 45), np.uint8)
        pixels[:, 15 * index : 15 * index + 15] = 255
        whole.append(cv2.imencode(".png", pixels)[1].tobytes())
        (folder / f"{index}.png").write_bytes(whole[-1])

    def read(rng: Random) -> None:
        (folder / "1.png").write_bytes(of_header(whole[1], rng))
        read_masks(folder, Size(45, 31))

    return _guarded(read)


def photos(folder: Path) -> _Run:
    """Photos with EXIF data."""
    from scanner.photos.photo import read_photos

    exif = Image.Exif()
    exif[0x0112] = 6
    exif[0x010F] = "maker"
    exif.get_ifd(0x8769).update(
        {0xA405: 28, 0x9003: "2024:01:01 00:00:00", 0x920A: TiffImagePlugin.IFDRational(28, 10)}
    )
    stream = io.BytesIO()
    Image.fromarray(_picture(np.random.default_rng(0), 3, np.uint8)).save(stream, "JPEG", exif=exif)
    seed = stream.getvalue()
    (folder / "a.jpg").write_bytes(seed)

    def read(rng: Random) -> None:
        cut = 250 if rng.random() < 0.8 else len(seed)
        (folder / "b.jpg").write_bytes(of_bytes(seed[:cut], rng) + seed[cut:])
        read_photos([folder / "a.jpg", folder / "b.jpg"])

    return _guarded(read)


def cloud(folder: Path) -> _Run:
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

    return _guarded(read)


def poses(folder: Path) -> _Run:
    """`poses.yaml`."""
    from scanner.io import read_poses, write_poses

    path = folder / "poses.yaml"
    write_poses(path, [np.eye(3, 4), np.eye(3, 4)])
    seed = yaml.safe_load(path.read_text())

    def read(rng: Random) -> None:
        path.write_bytes(of_yaml(seed, rng))
        read_poses(path, 2)

    return _guarded(read)


def room(folder: Path) -> _Run:
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

    return _guarded(read)


def imports(folder: Path) -> _Run:
    """Others' folders: names of files, and what is written beside the frames."""
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

    return _guarded(read)


def results(folder: Path) -> _Run:
    """A result whose numbers are extreme and well-formed: read, measured, shown and exported."""
    from calib.pointcloud import build_cloud
    from scanner.exporting import FORMATS, Request
    from scanner.io import read_calibration, write_ply
    from scanner.measuring import measure, read_scene, tables
    from scanner.results import read_finished_scan
    from scanner.results.stated_uncertainty import COLUMNS
    from scanner.viewing.result import ViewedResult
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
        measured = measure(scan, read_scene(written.folder, found), [], [])
        for table in tables(measured):
            console.print(table)
        ViewedResult(written.folder).cloud("The capture")
        for name in ("opencv", "colmap", "ply", "mesh"):
            out = folder / f"out{FORMATS[name].ending}"
            FORMATS[name].write(Request(written.folder, out, True, 100))

    return _guarded(read)


def _spoil_normals(path: Path, rng: Random) -> None:
    """Some of the normals in a cloud are none, or of no length that anything has."""
    header, end, body = path.read_bytes().partition(b"end_header\n")
    vertices = np.frombuffer(bytearray(body), np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rest", "V7")]))
    chosen = rng.random(len(vertices)) < rng.choice([0.01, 1.0])
    vertices["normal"][chosen] = rng.choice([np.nan, np.inf, 3e38, 0.0])
    path.write_bytes(header + end + vertices.tobytes())


def calibrating(folder: Path) -> _Run:
    """Matches → faces → calibration → cloud, of numbers that are well-formed and not of any room."""
    from calib.geometry import Matches
    from calib.pointcloud import build_cloud
    from scanner.capture import CaptureFacts
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
        facts = CaptureFacts(CAMERA.size, PROJECTOR.size)
        given = Decoded(facts, Matches(camera_px, projector_px, labelled, sigma), GivenMatches(None), "fuzzed")
        config = Config(method="paper") if rng.random() < 0.2 else Config()
        for found in calibrate(label([given], [given]), config):
            build_cloud(found.decoded.matches, None, found.calibration)

    return _guarded(read)


_IMAGES = (".png", ".jpg", ".tif", ".bmp", ".webp", ".jp2", ".gif", ".pgm", ".ppm", ".ras", ".avif")
TARGETS: dict[str, Callable[[Path], _Run]] = {
    **{
        make.__name__: make
        for make in (capture, configuration, calibration, matches, masks, photos, cloud, poses, room, imports, results)
    },
    **{f"image{suffix}": image(suffix) for suffix in _IMAGES},
    "calibrating": calibrating,
}


def _wrong(rng: Random) -> None:
    raise KeyError(int(rng.integers(9)))


def _forever(rng: Random) -> None:
    end = time.process_time() + 1.0
    while time.process_time() < end:
        rng.random()


# What must be found, to see that it would be.
PLANTED: dict[str, Callable[[Path], _Run]] = {
    "wrong": lambda _: _guarded(_wrong),
    "forever": lambda _: _guarded(_forever),
    "memory": lambda _: _guarded(lambda rng: np.full(150_000_000, rng.random())[:0].sort()),
    "death": lambda _: _guarded(lambda _: os._exit(3)),
}
