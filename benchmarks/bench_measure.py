"""Errors over sigmas of measured angles, flatness, diameters and distances, from ground truth.

    python benchmarks/bench_measure.py --rooms 17

Furnished simulated rooms with a ball bar, walls off by 0.3°, the principal point unknown; small devices, for speed.
Each room is captured from three places: 'together' is their joint calibration, 'alone' the newest capture's own.
Everything is read back from the result folders, as `scan measure` does.
"""

import argparse
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats
from calib.refusal import NoMeasurementError
from hw.settings import SimulatedRigSettings
from hw.simulated import DrawnRoom, place_room, true_calibration
from scanner.commands import main as scan
from scanner.measuring import MeasuredScene, PlacedPoints, measure, read_scene
from scanner.results import FinishedScan, folder_of, read_finished_result, read_finished_scan

CAMERA, PROJECTOR = (612, 512), (427, 240)
DIAMETER_M, BAR_M, WALLS_OFF_DEG = 0.24, 0.4, 0.3
PLACES, PAIRS = 3, 4
RULER = 0.03

# Per kind of measurement: error, and sigma, scatter, smooth and calibration parts of the budget.
Errors = dict[str, list[tuple[float, ...]]]


def settings_of(seed: int, pose: int) -> SimulatedRigSettings:
    return SimulatedRigSettings(
        seed=seed, pose=pose, walls_off_deg=WALLS_OFF_DEG, sphere_radius_m=DIAMETER_M / 2, ball_bar_m=BAR_M
    )


def true_rig(room: DrawnRoom) -> Calibration:
    found = true_calibration(room)
    assert found is not None, "every room has a pinhole for a projector unless its picture is reshaped"
    return found


def note(errors: Errors, kind: str, error: float, budget: object) -> None:
    shares = [getattr(budget, name) for name in ("sigma", "scatter", "smooth", "calibration")]
    errors[kind].append((error, *shares))


def compare(errors: Errors, how: str, folder: Path, room: DrawnRoom) -> None:
    """Measure in one result, and record the errors."""
    found = read_finished_scan(folder)
    scene = read_scene(folder, found.calibration)
    true_normals = -room.scene.room.outward_normals[:3] @ room.camera.rotation.T
    nearest = {face.name: true_normals[np.argmax(true_normals @ face.normal)] for face in scene.faces}
    for angle in scene.angles:
        first, second = (nearest[name] for name in angle.faces)
        true_deg = 180 - np.degrees(np.arccos(first @ second))
        note(errors, f"{how}: angle, °", angle.angle_deg - true_deg, angle.budget)
    for face in scene.faces:
        note(errors, f"{how}: flatness, m", face.deviation, face.budget)
    note_lengths(errors, how, found, scene, true_rig(room))
    try:
        measured = measure(found, scene, [DIAMETER_M, DIAMETER_M])
    except NoMeasurementError as reason:
        print(f"  {folder.name}: {reason}"[:110])
        return
    for sphere in measured.spheres:
        note(errors, f"{how}: diameter, m", sphere.diameter - DIAMETER_M, sphere.diameter_budget)
    note(errors, f"{how}: ball bar, m", measured.distances[0].distance - BAR_M, measured.distances[0].budget)
    pairs = np.random.default_rng(0).choice(found.pixel, (PAIRS, 2), replace=False)
    ends = [((0, float(x1), float(y1)), (0, float(x2), float(y2))) for (x1, y1), (x2, y2) in pairs]
    points = PlacedPoints.of(read_finished_result(folder, 1), scene.errors)
    for distance in measure(found, scene, [], points, ends).distances:
        at = np.stack([found.pixel[np.argmin(np.linalg.norm(found.points - end, axis=1))] for end in distance.points])
        rays = room.camera.rays(at.T.astype(np.float64))
        t, _ = room.scene.cast(room.camera.centre[:, None], rays)
        true = float(np.linalg.norm(np.diff(t * rays, axis=1)))
        note(errors, f"{how}: distance of pixels, m", distance.distance - true, distance.budget)


def note_lengths(errors: Errors, how: str, found: FinishedScan, scene: MeasuredScene, truth: Calibration) -> None:
    """A short ruler in the middle of the scene: its length by the calibration, and the true one."""
    assert scene.lengths is not None
    middle, rig = scene.lengths.middle, found.calibration
    half = RULER * float(np.linalg.norm(middle))
    ends: Floats = np.concatenate([middle + half * np.eye(3), middle - half * np.eye(3)])
    seen = Matches(rig.camera.project(ends), rig.projector.project(rig.pose @ ends))
    true = intersect(seen, truth).points
    strain = np.linalg.norm(true[:3] - true[3:], axis=1) / (2 * half) - 1
    note(errors, f"{how}: lengths in the middle", float(np.sqrt(np.mean(strain**2))), scene.lengths.budget)


def run(seed: int, folder: Path, errors: Errors) -> None:
    rooms = [place_room(settings_of(seed, pose), CAMERA, PROJECTOR) for pose in range(PLACES)]
    settings = settings_of(seed, 0).model_dump(include={"seed", "walls_off_deg", "sphere_radius_m", "ball_bar_m"})
    config = folder / f"{seed}.yaml"
    config.write_text(
        f"rig: {settings}\n".replace("'", "")
        + f"camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}}}\n"
        + f"projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}\n"
        + f"scale: {{baseline_m: {true_rig(rooms[0]).baseline}}}\n"
    )
    together, alone = folder / f"{seed}-together", folder / f"{seed}-alone"
    asked = ["--config", str(config), "--quiet", "--out"]
    if scan([*asked, str(together), "--captures", str(PLACES)]) == 0:
        for place, room in enumerate(rooms):
            compare(errors, "together", folder_of(together, place, PLACES), room)
        known = true_rig(rooms[-1]).camera.principal_point_px
        point = f"camera.principal_point.known={list(known)}"
        if scan(["calibrate", str(together / "matches.npz"), *asked, str(alone), "--set", point]) == 0:
            compare(errors, "alone", alone, rooms[-1])
    print(f"seed {seed} done", flush=True)


def show(errors: Errors) -> None:
    print(f"{'':34}{'n':>5}{'error/sigma, rms':>18}{'median |error|':>16}{'sigma':>10}   scatter, smooth, calibration")
    for kind in sorted(errors):
        table = np.array(errors[kind])
        ratio = float(np.sqrt(np.mean((table[:, 0] / table[:, 1]) ** 2)))
        medians = np.median(np.abs(table), axis=0)
        shares = ", ".join(f"{share:.2g}" for share in medians[2:])
        print(f"{kind:34}{len(table):5}{ratio:18.2f}{medians[0]:16.2g}{medians[1]:10.2g}   {shares}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=17)
    parser.add_argument("--first", type=int, default=0, help="seed of the first room")
    options = parser.parse_args()
    errors: Errors = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.first, options.first + options.rooms):
            run(seed, Path(folder), errors)
    show(errors)


if __name__ == "__main__":
    main()
