"""The paper's test with a ball (section 5), on whole scans of simulated rooms: detection, size and form errors.

    python benchmarks/bench_ball.py --seeds 0 1 2 3 --diameters-mm 100 240

The walls are square and known to be, the baseline and the camera's principal point are given. The ball takes no part in
the calibration; its diameter and position are known exactly.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from hw.settings import SimulatedRigSettings
from hw.simulated import draw_room, true_calibration
from scanner.commands import main as scan

ROOM_SIM = Path(__file__).parents[1] / "configs" / "room-sim.yaml"


def run(seed: int, diameter_mm: float, folder: Path) -> tuple[float, float] | None:
    """Scan, measure and print; size error and mean absolute error in mm, or None if the ball was not found."""
    radius_m = diameter_mm / 2000
    room = draw_room(SimulatedRigSettings(seed=seed, sphere_radius_m=radius_m))
    settings = {
        "rig.seed": seed,
        "rig.walls_off_deg": 0,
        "corner.squareness_deg": 0,
        "camera.principal_point": "{known: [628.15, 527.15]}",
        "rig.sphere_radius_m": radius_m,
        "scale.baseline_m": true_calibration(room).baseline,
    }
    assigned = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    result = folder / f"{seed}-{diameter_mm:g}"
    name = f"seed {seed}, {diameter_mm:g} mm:"
    if scan(["--config", str(ROOM_SIM), *assigned, "--out", str(result), "--quiet"]):
        print(name, "the capture was refused")
        return None
    if scan(["measure", str(result), "--sphere", f"{diameter_mm}mm", "--quiet"]):
        print(name, "the ball was not found")
        return None
    document = json.loads((folder / f"{result.name}-measured" / "measure.json").read_text())
    (sphere,) = document["spheres"]
    assert room.scene.sphere is not None
    centre = room.camera.rotation @ (room.scene.sphere.centre - room.camera.centre)
    apart_mm = 1e3 * float(np.linalg.norm(np.array(sphere["centre"]) - centre))
    size_error_mm = 1e3 * sphere["diameter"] - diameter_mm
    mean_absolute_mm = 1e3 * sphere["mean_absolute_error"]
    print(
        f"{name} {sphere['points']} points at {np.linalg.norm(centre):.2f} m, size {size_error_mm:+.3f} "
        f"± {1e3 * sphere['diameter_sigma']:.3f} mm, mean absolute error {mean_absolute_mm:.3f} mm, "
        f"centre {apart_mm:.3f} mm from the truth"
    )
    return size_error_mm, mean_absolute_mm


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    parser.add_argument("--diameters-mm", type=float, nargs="+", default=[100, 240])
    options = parser.parse_args()
    for diameter_mm in options.diameters_mm:
        with tempfile.TemporaryDirectory() as folder:
            found = [run(seed, diameter_mm, Path(folder)) for seed in options.seeds]
        errors = np.array([errors for errors in found if errors is not None])
        if len(errors):
            size, form = np.abs(errors).mean(axis=0)
            print(
                f"{diameter_mm:g} mm: found {len(errors)} of {len(found)}; mean of |size error| {size:.3f} mm, of the "
                f"mean absolute error {form:.3f} mm"
            )


if __name__ == "__main__":
    main()
