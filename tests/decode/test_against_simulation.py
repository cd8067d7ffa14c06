"""The decoder before a simulated room: light that bounces, gamma, blur, noise. The truth is the room's, not ours."""

from dataclasses import dataclass

import numpy as np
import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.simulation import SimulatedRoom
from hw.simulated.truth import GroundTruth
from scanner.decode import Decoder, Decoding, MaskReason
from scanner.patterns import draw, sequence_for

CAMERA, PROJECTOR = (612, 512), (428, 240)

pytestmark = pytest.mark.xdist_group("decode-simulation")


@dataclass(frozen=True)
class Scanned:
    decoding: Decoding
    truth: GroundTruth

    @property
    def error_px(self) -> np.ndarray:
        """Distance of each match from the truth, NaN where the projector does not light its pixel directly."""
        x, y = np.rint(self.decoding.matches.camera_px).astype(int).T
        return np.linalg.norm(self.decoding.matches.projector_px - self.truth.projector_px[y, x], axis=1)


def scanned(settings: SimulatedRigSettings) -> Scanned:
    room = SimulatedRoom(settings, CAMERA, PROJECTOR)
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    patterns = sequence_for(PROJECTOR)
    decoder = Decoder(patterns, PROJECTOR)
    for pattern in patterns:
        projector.show(draw(pattern, PROJECTOR))
        decoder.add(camera.grab().image)
    return Scanned(decoder.finish(), room.ground_truth())


@pytest.fixture(scope="module")
def room() -> Scanned:
    return scanned(SimulatedRigSettings(seed=0))


def test_error_of_the_matches(room: Scanned) -> None:
    error = room.error_px[np.isfinite(room.error_px)]
    assert 0.01 < np.median(error) < 0.06
    assert 0.05 < np.percentile(error, 99) < 0.5
    assert 0.1 < np.percentile(error, 99.9) < 1.0


def test_share_of_the_lit_pixels_that_is_kept(room: Scanned) -> None:
    lit = np.isfinite(room.truth.projector_px[..., 0])
    kept = room.decoding.reasons == MaskReason.KEPT
    assert 0.97 < (kept & lit).sum() / lit.sum() <= 1.0
    # Pixels half in shadow are lit a little although their centre is not.
    assert 0 <= (kept & ~lit).sum() / kept.sum() < 0.01


def test_sigma_is_of_the_size_of_the_error(room: Scanned) -> None:
    sigma = room.decoding.matches.sigma_px
    assert sigma is not None
    far_from_creases = np.isfinite(room.error_px)
    deviation = room.error_px[far_from_creases] / sigma[far_from_creases]
    # The median length of a 2-D normal deviate is 1.18; interreflection is not in the sigma.
    assert 0.6 < np.median(deviation) < 4.0


def test_a_dark_room_is_masked_not_guessed() -> None:
    dim = scanned(SimulatedRigSettings(seed=0, albedo=0.05, ambient=2.0))
    error = dim.error_px[np.isfinite(dim.error_px)]
    assert 0.01 < np.median(error) < 0.5
    assert np.percentile(error, 99) < 3.0
