"""Make the pictures of the documentation from a result:  python docs/make_pictures.py scans/room-sim

Draws what the report draws: the faces over the camera's image, and the point cloud with both devices.
"""

import argparse
import re
from base64 import b64decode
from pathlib import Path

import cv2
import numpy as np

_HEIGHT = 520
_PAPER = 255.0


def pictures(report: Path) -> list[np.ndarray]:
    """The pictures embedded in a report, in its order, BGR on white paper."""
    found = []
    for encoded in re.findall(r"data:image/(?:png|jpeg);base64,([A-Za-z0-9+/=]+)", report.read_text(encoding="utf-8")):
        picture = cv2.imdecode(np.frombuffer(b64decode(encoded), np.uint8), cv2.IMREAD_UNCHANGED)
        if picture.ndim == 3 and picture.shape[2] == 4:
            opacity = picture[..., 3:] / 255.0
            picture = np.rint(picture[..., :3] * opacity + _PAPER * (1 - opacity)).astype(np.uint8)
        found.append(picture)
    return found


def main() -> None:
    """Write docs/images/<name of the result>.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path, help="a result folder")
    result = parser.parse_args().result
    faces, oblique, *_ = pictures(result / "report.html")
    both = [
        cv2.resize(p, (round(p.shape[1] * _HEIGHT / p.shape[0]), _HEIGHT), interpolation=cv2.INTER_AREA)
        for p in (faces, oblique)
    ]
    target = Path(__file__).parent / "images" / f"{result.name}.png"
    target.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(target), np.hstack(both), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(target)


if __name__ == "__main__":
    main()
