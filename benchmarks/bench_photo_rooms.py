"""Rendered photos of a textured corner, from features to the errors of f and principal point.

    python benchmarks/bench_photo_rooms.py --rooms 4 --seed 0

The simulator's room with patterned walls, lit by its ceiling only, from two or three poses: all light transport, lens
distortion, blur and noise. Walls are square unless --walls-off is given. The poses suit a rig, and are not optimal for
photos.
"""

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from calib.geometry import Intrinsics
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.commands import main as scan
from scanner.io import read_calibration

SIZE = (1600, 1200)
PICTURE = (64, 36)  # the projector stays dark


def rendered(seed: int, pose: int, walls_off_deg: float, path: Path) -> Intrinsics:
    """Write a photo; returns its camera."""
    settings = SimulatedRigSettings(
        seed=seed, pose=pose, walls_off_deg=walls_off_deg, ambient=10.0, furniture=False, wallpaper=True
    )
    room = SimulatedRoom(settings, SIZE, PICTURE)
    electrons = room.electrons(np.zeros(PICTURE[::-1], np.uint8))
    cv2.imwrite(str(path), room.sensor.read(electrons, np.random.default_rng([seed, pose])))
    return room.calibration.camera


def answer(folder: Path, count: int, squareness_deg: float, camera: Intrinsics) -> str:
    """Errors with the photos 0 … count − 1, as text."""
    out = folder / f"of-{count}"
    photos = [str(folder / f"{pose}.png") for pose in range(count)]
    start = time.perf_counter()
    code = scan(["photos", *photos, "--out", str(out), "--quiet", "--set", f"corner.squareness_deg={squareness_deg}"])
    seconds = time.perf_counter() - start
    if code:
        return f"refused (exit code {code}), {seconds:.0f} s"
    found = read_calibration(out / "calibration.yaml")
    focal, sigma = camera.focal_px[0], found.sigma.camera.focal_px[0]
    off = np.subtract(found.camera.principal_point_px, camera.principal_point_px)
    return (
        f"f {100 * (found.camera.focal_px[0] / focal - 1):+.2f} % (σ {100 * sigma / focal:.2f} %), "
        f"PP {off[0]:+.1f}, {off[1]:+.1f} px (σ {found.sigma.camera.principal_point_px[0]:.1f}, "
        f"{found.sigma.camera.principal_point_px[1]:.1f}), {seconds:.0f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--walls-off", type=float, default=0.0, metavar="DEGREES")
    options = parser.parse_args()
    for seed in range(options.seed, options.seed + options.rooms):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            cameras = [rendered(seed, pose, options.walls_off, folder / f"{pose}.png") for pose in range(3)]
            for count in (2, 3):
                print(
                    f"room {seed}, {count} photos: {answer(folder, count, options.walls_off, cameras[0])}", flush=True
                )


if __name__ == "__main__":
    main()
