"""Decoders by others on frames from a file, for `bench_decode.py --peer-python`; prints seconds as JSON.

Runs in a separate environment, because opencv-contrib cannot be installed beside opencv-python-headless, which
roomscan needs: python -m venv peers && peers/bin/pip install opencv-contrib-python-headless fringes
"""

import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np

_SAMPLED = 20_000


def opencv_seconds(frames: np.ndarray, projector: tuple[int, int]) -> float:
    """OpenCV's Gray code, called per pixel as in its samples; some thousand pixels, scaled up to all."""
    decoder = cv2.structured_light.GrayCodePattern.create(*projector)  # type: ignore[attr-defined]
    images = list(frames)
    height, width = frames.shape[1:]
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, width, _SAMPLED), rng.integers(0, height, _SAMPLED)
    start = time.perf_counter()
    for column, row in zip(x.tolist(), y.tolist(), strict=True):
        decoder.getProjPixel(images, column, row)
    return float((time.perf_counter() - start) * width * height / _SAMPLED)


def fringes_seconds(frames: np.ndarray, projector: tuple[int, int], periods: list[float], shifts: int) -> float:
    """The package Fringes: whole images, compiled by Numba; along both axes the fringes of `periods`."""
    from fringes import Fringes

    decoder = Fringes()
    decoder.X, decoder.Y = projector
    decoder.N = shifts
    decoder.v = [max(projector) / period for period in periods]
    images = frames[..., None]
    decoder.decode(images[:, :64, :64])
    start = time.perf_counter()
    decoder.decode(images)
    return time.perf_counter() - start


def main() -> None:
    job = json.loads(sys.stdin.read())
    folder, projector = Path(job["folder"]), tuple(job["projector"])
    found = {"opencv": opencv_seconds(np.load(folder / "gray.npy", mmap_mode="r"), projector)}
    try:
        fringes = np.load(folder / "fringes.npy", mmap_mode="r")
        found["fringes"] = fringes_seconds(fringes, projector, job["periods"], job["shifts"])
    except ImportError:
        print("the package fringes is not installed there", file=sys.stderr)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
