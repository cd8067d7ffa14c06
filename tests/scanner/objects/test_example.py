"""The example of a thing in configs/, which `make object` scans."""

import numpy as np
import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated.things import SimulatedThing
from scanner.configuration import load_config
from scanner.io import read_calibration
from tests.support.places import ROOT


def test_the_example_has_the_calibration_of_its_rig() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    config = load_config(ROOT / "configs" / "thing-sim.yaml")
    assert isinstance(config.rig, SimulatedRigSettings)
    sizes = [(device.width, device.height) for device in (config.camera, config.projector)]
    truth = SimulatedThing(config.rig, *sizes).calibration
    calibration = read_calibration(ROOT / "configs" / "calibrations" / "thing-sim.yaml")
    assert (calibration.camera, calibration.projector) == (truth.camera, truth.projector)
    np.testing.assert_allclose(calibration.pose.matrix, truth.pose.matrix, rtol=0, atol=1e-12)
