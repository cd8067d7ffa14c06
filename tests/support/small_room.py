"""Simulated rooms that are scanned in seconds."""

import pytest

CONFIG = """
rig: {backend: simulated, furniture: false, interreflection: false, ambient: 0}
camera: {width: 306, height: 256, principal_point: {known: [157.04, 131.79]}}
projector: {width: 214, height: 120}
sequence: {preset: quick}
corner: {squareness_deg: 0}
"""


def with_few_rays(patch: pytest.MonkeyPatch) -> None:
    """Let an eighth of the rays gather the indirect light of rooms: these are made in half of the time."""
    patch.setattr("hw.simulated.renderer._RAYS_PER_NODE", 48)
