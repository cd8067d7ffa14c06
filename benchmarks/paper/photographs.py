"""Figure 8: two photographs of a corner, original and cropped, by `scan photos` and by COLMAP."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
from bench_photo_rooms import SIZE, rendered
from peer_photos import PEERS, two_view

from calib.geometry import Intrinsics, Size
from paper.captures import Setup
from paper.experiment import Experiment, Figures, room_of, rooms
from scanner.commands import main as scan
from scanner.io import MATCHES_FILE, read_calibration, read_image, read_matches
from scanner.results import CALIBRATION_FILE

CUT_OFF = (0.2, 0.15)  # shares of width and height, on the left and at the top


def _measure(_: Setup, part: str) -> Figures:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "whole").mkdir()
        (folder / "cropped").mkdir()
        left, top = (round(share * side) for share, side in zip(CUT_OFF, SIZE, strict=True))
        for pose in range(2):
            camera = rendered(room_of(part), pose, 0.0, folder / "whole" / f"{pose}.png")
            photo = read_image(folder / "whole" / f"{pose}.png")
            cv2.imwrite(str(folder / "cropped" / f"{pose}.png"), photo[top:, left:])
        x, y = camera.principal_point_px
        smaller = Intrinsics(camera.width - left, camera.height - top, camera.focal_px, (x - left, y - top))
        return {"original": _answers(folder / "whole", camera), "cropped": _answers(folder / "cropped", smaller)}


def _answers(folder: Path, camera: Intrinsics) -> Figures:
    """The truth, and the errors of (f, x_0, y_0) in px; None for a refusal. The corner is square, and known to be."""
    figures: Figures = {"size": list(camera.size), "truth_px": [camera.focal_px[0], *camera.principal_point_px]}
    truth, out = np.array(figures["truth_px"]), folder / "result"
    photos = [str(folder / f"{pose}.png") for pose in range(2)]
    code = scan(["photos", *photos, "--out", str(out), "--quiet", "--set", "corner.squareness_deg=0"])
    figures["exit_code"] = code
    figures["refined"] = figures["sigma_px"] = None
    if code == 0:
        found = read_calibration(out / CALIBRATION_FILE)
        sigma = found.sigma.camera
        assert sigma.focal_px is not None
        assert sigma.principal_point_px is not None
        figures["refined"] = _off([found.camera.focal_px[0], *found.camera.principal_point_px], truth)
        figures["sigma_px"] = [float(value) for value in (sigma.focal_px[0], *sigma.principal_point_px)]
    for peer in PEERS if (out / MATCHES_FILE).exists() else ():
        answer = two_view(read_matches(out / MATCHES_FILE), Size(*camera.size), peer)
        figures[f"COLMAP, {peer}"] = None if answer is None else _off(answer, truth)
    return figures


def _off(found: list[float] | np.ndarray, truth: np.ndarray) -> list[float]:
    return [float(error) for error in np.asarray(found) - truth]


PHOTOGRAPHS = Experiment("figure8", rooms, _measure)
