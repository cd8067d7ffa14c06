"""Captures made with real cameras and projectors, against what an independent decoder measured on them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from calib.triangulation import intersect
from scanner.calibration_file import read_calibration
from scanner.decode import Decoder, Decoding
from scanner.recording import open_capture

DATA = Path(__file__).parents[3] / "shared" / "data"

pytestmark = [
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the real captures are not there: {DATA}"),
    pytest.mark.xdist_group("real-captures"),
]


def decoded(name: str) -> Decoding:
    stream = open_capture(DATA / name).stream()
    decoder = Decoder(stream.patterns, stream.projector_size)
    for _, frame in stream.frames:
        decoder.add(frame.image)
    return decoder.finish()


def test_gray_code_of_a_shell() -> None:
    matches = decoded("sltk-scan0020").matches
    # 104,763 different projector pixels by the independent decoder.
    assert 100_000 < len(matches) < 110_000
    calibration = read_calibration(DATA / "sltk-scan0020" / "calibration.yaml")
    met = intersect(matches, calibration)
    assert met.in_front.mean() > 0.999
    assert 0.1 < np.median(np.abs(met.residual_px)) < 0.34
    header, body = (DATA / "sltk-scan0020" / "reference.ply").read_bytes().split(b"end_header\n", 1)
    layout = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
    reference = np.frombuffer(body, layout)["xyz"].astype(np.float64) * [1, -1, -1]
    assert f"element vertex {len(reference)}".encode() in header
    distance = cKDTree(reference).query(met.points[met.in_front])[0]
    assert 0.001 < np.median(distance) < 0.02
    assert 0.1 < np.percentile(distance, 95) < 0.45


@pytest.mark.parametrize(("name", "fewest", "limit_px"), [("object1", 1_300_000, 2.3), ("object2", 1_300_000, 2.4)])
def test_fringes_of_two_periods_with_a_bent_cosine(name: str, fewest: int, limit_px: float) -> None:
    matches = decoded(f"phase-shifting-{name}").matches
    assert fewest < len(matches) < 1_600_000
    part = np.random.default_rng(0).permutation(len(matches))[:20_000]
    camera, projector = matches.camera_px[part], matches.projector_px[part]
    fundamental, _ = cv2.findFundamentalMat(camera, projector, cv2.FM_LMEDS)
    lines = np.concatenate([camera, np.ones((len(camera), 1))], axis=1) @ fundamental.T
    distance = np.abs(np.sum(lines[:, :2] * projector, axis=1) + lines[:, 2]) / np.linalg.norm(lines[:, :2], axis=1)
    assert 0.2 < np.median(distance) < limit_px
