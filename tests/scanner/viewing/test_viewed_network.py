"""A network to look at: every device where its file says, and the cloud in the same frame."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from scanner.errors import InputError
from scanner.viewing.network import network_cloud
from tests.support.mapped_room import write_network


def test_every_device_is_where_the_file_says(tmp_path: Path) -> None:
    folder = write_network(tmp_path / "hall", np.random.default_rng(0))
    devices = {each["name"]: each for each in yaml.safe_load((folder / "network.yaml").read_text())["devices"]}

    viewed = network_cloud(folder)

    assert len(viewed.points) > 1000
    assert {name for rig in viewed.rigs for name in rig.names or ()} == {*devices}
    for rig in viewed.rigs:
        camera, projector = (devices[name] for name in rig.names or ())
        np.testing.assert_allclose(rig.position, camera["translation"])
        np.testing.assert_allclose(rig.projector_centre, projector["translation"], atol=1e-9)
        ahead = rig.pose.rotation @ rig.calibration.pose.rotation.T  # of the projector, in the network's frame
        np.testing.assert_allclose(ahead, projector["rotation"], atol=1e-9)
        assert rig.calibration.camera.focal_px == tuple(camera["focal_px"])


def test_network_without_a_projector_is_refused(tmp_path: Path) -> None:
    folder = write_network(tmp_path / "hall", np.random.default_rng(0))
    document = yaml.safe_load((folder / "network.yaml").read_text())
    for each in document["devices"]:
        each["kind"] = "camera"
    (folder / "network.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match="expected a camera and a projector"):
        network_cloud(folder)
