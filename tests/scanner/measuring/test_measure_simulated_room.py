"""The ball of a simulated room, from frames to `measure.json`, against the room's truth."""

import json
from pathlib import Path

import numpy as np
import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import SimulatedRoom
from scanner.commands.main import main

CAMERA, PROJECTOR = (612, 512), (427, 240)
RADIUS_M = 0.12

pytestmark = pytest.mark.xdist_group("measured room")


def test_the_ball_of_a_simulated_room(tmp_path: Path) -> None:
    room = SimulatedRoom(SimulatedRigSettings(seed=0, sphere_radius_m=RADIUS_M), CAMERA, PROJECTOR)
    config = tmp_path / "room.yaml"
    config.write_text(
        f"rig: {{backend: simulated, seed: 0, sphere_radius_m: {RADIUS_M}}}\n"
        f"camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}, principal_point: {{known: [314.1, 263.6]}}}}\n"
        f"projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}\n"
        "corner: {squareness_deg: 0}\n"
        f"scale: {{baseline_m: {room.calibration.baseline}}}\n"
    )
    assert main(["--config", str(config), "--out", str(tmp_path / "room"), "--quiet"]) == 0
    assert main(["measure", str(tmp_path / "room"), "--sphere", "240mm", "--quiet"]) == 0
    document = json.loads((tmp_path / "room-measured/measure.json").read_text())
    (sphere,) = document["spheres"]

    eye, ball = room.room.camera, room.room.scene.sphere
    assert ball is not None
    centre = eye.rotation @ (ball.centre - eye.centre)
    assert 0 < abs(sphere["diameter"] / (2 * RADIUS_M) - 1) < 0.01
    assert 0 < np.linalg.norm(np.array(sphere["centre"]) - centre) / np.linalg.norm(centre) < 0.005
    assert 1e-5 < sphere["mean_absolute_error"] < 1e-3
    assert all(0 < abs(angle["angle_deg"] - 90) < 0.1 for angle in document["angles"])
