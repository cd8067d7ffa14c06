"""Make the animation of the README from a result:  python docs/make_animation.py scans/room-sim

Three scenes: the camera's frames while patterns are shown, the projector coordinate of every decoded pixel, and the
point cloud with both devices, which the viewer walks around.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from calib.pointcloud import Cloud, build_cloud
from scanner.rendering.cloud_views import Wireframe, render, rig_frusta, view_along
from scanner.results import FinishedScan, read_finished_scan

Box: TypeAlias = tuple[int, int, int, int]  # left, top, width, height

_SIZE = (480, 360)  # width, height
_GREYS, _COLOURS = 40, 200  # of the palettes: more would double the file
_PATTERN_MS, _STILL_MS, _TURN_MS = 170, 1500, 90
_SWING_DEG, _TURNS = 32.0, 28
_CAMERA, _PROJECTOR, _WHITE = (0, 114, 178), (213, 94, 0), (255, 255, 255)


def patterns(capture: Path, box: Box) -> Iterator[NDArray[np.uint8]]:
    """The camera's frames of white, of every Gray code bit and of one fringe an axis, without inverses, RGB."""
    listing = yaml.safe_load((capture / "capture.yaml").read_text(encoding="utf-8"))["frames"]
    for entry in listing:
        pattern = entry["pattern"]
        if pattern["kind"] == "black" or pattern.get("inverted") or pattern.get("shift"):
            continue
        image = cv2.imread(str(capture / entry["file"]), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        smooth = np.asarray(cv2.bilateralFilter(image, 5, 12, 2), np.uint8)  # noise does not compress
        shown = cut(smooth, box)
        yield np.asarray(cv2.cvtColor(brightened(shown), cv2.COLOR_GRAY2RGB), np.uint8)


def brightened(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Light as a display shows it: frames are linear."""
    return np.rint(255 * (np.arange(256) / 255) ** (1 / 1.6)).astype(np.uint8)[image]


def box_of(scan: FinishedScan) -> Box:
    """The part of the camera's image with all decoded pixels, a margin, and the animation's proportions."""
    low, high = np.percentile(scan.pixel, (0.1, 99.9), axis=0)
    half = 0.58 * float(np.max((high - low) / _SIZE)) * np.array(_SIZE)
    limit = (scan.calibration.camera.width, scan.calibration.camera.height)
    corner = np.clip((low + high) / 2 - half, 0, np.maximum(0, limit - 2 * half)).astype(int)
    return int(corner[0]), int(corner[1]), int(2 * half[0]), int(2 * half[1])


def cut(picture: NDArray[np.uint8], box: Box) -> NDArray[np.uint8]:
    """That part of a picture at the animation's size."""
    left, top, width, height = box
    part = picture[top : top + height, left : left + width]
    return np.asarray(cv2.resize(part, _SIZE, interpolation=cv2.INTER_AREA), np.uint8)


def coordinates(scan: FinishedScan, white: NDArray[np.uint8], box: Box) -> NDArray[np.uint8]:
    """The projector column of each decoded pixel as a colour, over what the camera saw, RGB."""
    camera, projector = scan.calibration.camera, scan.calibration.projector
    shades = np.zeros((camera.height, camera.width), np.uint8)
    lit = np.zeros_like(shades)
    column, row = scan.pixel.T
    shades[row, column] = np.clip(255 * scan.matches.projector_px[:, 0] / projector.width, 0, 255)
    lit[row, column] = 255
    coloured = cv2.cvtColor(cv2.applyColorMap(shades, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    mask = cut(lit, box)[..., None] / 255
    return np.rint(cut(np.asarray(coloured, np.uint8), box) * mask + white * 0.5 * (1 - mask)).astype(np.uint8)


def turning(cloud: Cloud, scan: FinishedScan) -> Iterator[NDArray[np.uint8]]:
    """The cloud and both devices, seen from places around it, RGB on white."""
    points = cloud.points[np.isfinite(cloud.points[..., 2])]
    centre = np.median(points, axis=0)
    frusta = rig_frusta(scan.calibration, 0.25 * float(np.linalg.norm(centre)), _CAMERA, _PROJECTOR)
    everything = np.concatenate([points[::50], *(each.segments.reshape(-1, 3) for each in frusta)])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    radius = 0.62 * float(np.max(np.linalg.norm(everything - middle, axis=1)))
    for turn in np.radians(_SWING_DEG) * np.sin(np.linspace(0, 2 * np.pi, _TURNS, endpoint=False)):
        forward = np.array([np.sin(turn - 0.35), 0.42, np.cos(turn - 0.35)])
        view = view_along(forward, np.array([0.0, -1.0, 0.0]))
        # Marks at the border, so that the scale is the same from everywhere.
        reach = radius * np.array([_SIZE[0] / _SIZE[1], 1.0])[:, None] * view.axes[:2]
        marks = np.concatenate([middle + reach, middle - reach])
        frame = Wireframe(np.stack([marks, marks], axis=1), _WHITE)
        drawn = render(cloud, view, _SIZE, [frame, *frusta])
        opacity = drawn[..., 3:] / 255
        picture = np.full((_SIZE[1], _SIZE[0], 3), 255, np.uint8)
        height, width = (min(side, most) for side, most in zip(drawn.shape[:2], picture.shape[:2], strict=True))
        top, left = (_SIZE[1] - height) // 2, (_SIZE[0] - width) // 2
        on_white = drawn[..., :3] * opacity + 255 * (1 - opacity)
        picture[top : top + height, left : left + width] = np.rint(on_white[:height, :width])
        yield picture


def main() -> None:
    """Write docs/images/scan.gif."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path, help="a result folder with its recording")
    folder = parser.parse_args().result
    scan = read_finished_scan(folder)
    box = box_of(scan)
    shown = list(patterns(folder / "capture", box))
    white = cv2.imread(str(min((folder / "capture" / "frames").iterdir())), cv2.IMREAD_GRAYSCALE)
    assert white is not None
    cloud = build_cloud(scan.matches, np.asarray(white, np.uint8), scan.calibration)
    scenes = [(picture, _PATTERN_MS, _GREYS) for picture in shown]
    scenes.append((coordinates(scan, shown[0], box), _STILL_MS, _COLOURS))
    scenes += [(picture, _TURN_MS, _GREYS) for picture in turning(cloud, scan)]
    images = [Image.fromarray(picture).quantize(colours, dither=Image.Dither.NONE) for picture, _, colours in scenes]
    target = Path(__file__).parent / "images" / "scan.gif"
    durations = [duration for _, duration, _ in scenes]
    images[0].save(target, save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=True)
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB, {sum(durations) / 1000:.0f} s")


if __name__ == "__main__":
    main()
