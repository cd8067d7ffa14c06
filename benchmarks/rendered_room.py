"""Whole rooms rendered by Mitsuba 3, as captures with ground truth, independent of this project's simulation.

    python benchmarks/rendered_room.py SEQUENCE OUT [--seed 0] [--stations 6] [--paths 1024] [--tangential 0.0003]

SEQUENCE is a folder of `scan patterns`. Mitsuba (`pip install mitsuba`, and a libLLVM) computes the scene, its textures
and all intersections; light is traced here. Rendering is linear in the projector's picture, so paths are traced once
for all patterns. Direct light of a camera pixel comes from nine sub-pixels. Light after one or two bounces is stored as
a histogram over the picture's columns and rows, on a coarser grid. OUT/1, OUT/2, … are captures; OUT/truth.npz has
poses, devices and the points of all camera pixels.
"""

import argparse
from pathlib import Path

import cv2
import mitsuba as mi
import numpy as np
import yaml
from numpy.typing import NDArray
from rendered import (
    Array,
    Device,
    Place,
    Rig,
    bounced_light,
    direct_light,
    draw_rig,
    ring,
    room,
    spread,
    trace,
    world_rays,
)

_FULL_WELL, _READ_NOISE, _AMBIENT = 20_000.0, 8.0, 0.02  # electrons, electrons, share of white
_FINE = 64  # steps per pixel of the picture, interpolated linearly


def capture(
    scene: "mi.Scene", rig: Rig, place: Place, sequence: Path, out: Path, seed: int, paths: int
) -> dict[str, NDArray[np.float32]]:
    """One station's frames; returns the points of its pixels, (H, W, 3) in the camera's frame."""
    rng = np.random.default_rng(seed)
    width, height = rig.camera.size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    seen = trace(scene, *world_rays(rig, place, np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)))
    at, bright = direct_light(scene, rig, place, rng)
    by_axis, coarse = bounced_light(scene, rig, place, rng, paths)
    to_pixels = spread(coarse, seen, rig.camera.size)
    at = np.rint(_FINE * np.nan_to_num(at)).astype(np.int32).clip(0)

    def picture(pattern: NDArray[np.uint8], axis: int) -> Array:
        light = (pattern[0, :] if axis == 0 else pattern[:, 0]).astype(np.float64) / 255
        between = np.interp(np.arange(_FINE * len(light)) / _FINE, np.arange(len(light)), light)
        direct = np.mean(between[at[..., axis].clip(max=len(between) - 1)] * bright, axis=2)
        bounced = to_pixels @ (by_axis[axis] @ light) * seen.albedo
        light_of_pixels: Array = direct + bounced.reshape(height, width)
        return light_of_pixels

    described = yaml.safe_load((sequence / "sequence.yaml").read_text())
    white = np.full(rig.projector.size[::-1], 255, np.uint8)
    full = picture(white, 0)
    brightest = np.percentile(full, 99)
    if brightest == 0:
        raise SystemExit(f"station {out.name}: less than 1 % of what its camera sees is lit; take another --seed")
    exposure = 0.9 / brightest
    (out / "frames").mkdir(parents=True)
    frames = []
    for number, entry in enumerate(described["frames"]):
        pattern = np.array(cv2.imread(str(sequence / entry["file"]), cv2.IMREAD_GRAYSCALE), np.uint8)
        light = picture(pattern, 1 if entry["pattern"].get("axis") == "y" else 0) * exposure + _AMBIENT
        electrons = rng.poisson(np.clip(light, 0, 1.2) * _FULL_WELL) + rng.normal(0, _READ_NOISE, light.shape)
        grey = np.clip(np.rint(electrons / _FULL_WELL * 255), 0, 255).astype(np.uint8)
        cv2.imwrite(str(out / "frames" / f"{number:03d}.png"), grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        frames.append({"file": f"frames/{number:03d}.png", "pattern": entry["pattern"]})
    document = {
        "format": 1,
        "projector": dict(zip(("width", "height"), rig.projector.size, strict=True)),
        "camera": dict(zip(("width", "height"), rig.camera.size, strict=True)),
        "frames": frames,
    }
    (out / "capture.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    in_camera = (seen.points - place.translation) @ place.rotation
    return {"points": in_camera.reshape(height, width, 3).astype(np.float32)}


def _told(device: Device) -> Array:
    return np.array([*device.size, device.focal, *device.centre, *device.lens])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stations", type=int, default=6)
    parser.add_argument("--paths", type=int, default=1024)
    parser.add_argument("--tangential", type=float, default=0.0)
    args = parser.parse_args()
    rng = np.random.default_rng([90, args.seed])
    rig = draw_rig(rng, args.tangential)
    size = np.array([rng.uniform(4.2, 4.8), rng.uniform(3.4, 3.8), rng.uniform(2.5, 2.7)])
    described, boxes, balls = room(rng, size)
    scene = mi.load_dict(described)
    places = ring(rng, size, boxes, args.stations)
    seen = []
    for number, place in enumerate(places, start=1):
        seen.append(
            capture(scene, rig, place, args.sequence, args.out / str(number), 1000 * args.seed + number, args.paths)
        )
        print(f"station {number} rendered", flush=True)
    np.savez_compressed(
        args.out / "truth.npz",
        rotation=rig.rotation,
        translation=rig.translation,
        camera=_told(rig.camera),
        projector=_told(rig.projector),
        rotations=np.stack([place.rotation for place in places]),
        translations=np.stack([place.translation for place in places]),
        points=np.stack([each["points"] for each in seen]),
        balls=balls,
        diagonal=np.linalg.norm(size),
    )


if __name__ == "__main__":
    main()
