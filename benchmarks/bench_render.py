"""Rendering speed of the simulated rig, and statistics of its views: python benchmarks/bench_render.py --seeds 10"""

import argparse
import resource
import time

import numpy as np

from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom, draw_room, look, true_calibration

SIZES = (((306, 256), (214, 120)), ((1224, 1024), (854, 480)), ((2448, 2048), (854, 480)))
FRAMES = 10


def time_rendering() -> None:
    print("camera       projector   construction    show    grab    peak memory so far")
    for camera_size, projector_size in SIZES:
        start = time.perf_counter()
        room = SimulatedRoom(SimulatedRigSettings(), camera_size, projector_size)
        construction_s = time.perf_counter() - start
        projector = SimulatedProjector(room)
        camera = SimulatedCamera(room, projector)
        pictures = np.random.default_rng(0).integers(0, 256, (FRAMES, *projector_size[::-1]), dtype=np.uint8)
        show_s = grab_s = 0.0
        for picture in pictures:
            start = time.perf_counter()
            projector.show(picture)
            shown = time.perf_counter()
            camera.grab()
            show_s += (shown - start) / FRAMES
            grab_s += (time.perf_counter() - shown) / FRAMES
        peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(
            f"{'{} × {}'.format(*camera_size):12} {'{} × {}'.format(*projector_size):10}"
            f"{construction_s:12.1f} s{1e3 * show_s:7.0f} ms{1e3 * grab_s:5.0f} ms{peak_gb:10.2f} GB"
        )


def describe_views(seeds: int) -> None:
    print("\nseed  distance  baseline  out of face  forward  lit   wall x  wall y  floor  furniture  sphere  in frame")
    for seed in range(seeds):
        room = draw_room(SimulatedRigSettings(seed=seed))
        view = look(room.scene, room.camera, room.projector)
        wall_x, wall_y, floor, _, furniture, sphere = view.label_shares
        print(
            f"{seed:4} {np.linalg.norm(room.camera.centre):8.2f} m{true_calibration(room).baseline:8.2f} m"
            f"{np.degrees(np.arcsin(view.baseline_out_of_face)):11.0f}° {view.forward:9.2f}{view.lit_share:7.2f}"
            f"{wall_x:8.2f}{wall_y:8.2f}{floor:7.2f}{furniture:10.2f}{sphere:9.2f}{view.picture_in_frame:9.3f}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="how many views to describe")
    arguments = parser.parse_args()
    time_rendering()
    describe_views(arguments.seeds)
