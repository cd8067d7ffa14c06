"""Make the pictures of the documentation from a result:  python docs/make_pictures.py scans/room-sim

Draws what the report draws, the faces over the camera's image and the point cloud with both devices, and some frames of
the recording. docs/make_view_pictures.py makes the pictures of good and bad views.
"""

import argparse
import re
from base64 import b64decode
from pathlib import Path

import cv2
import numpy as np
import yaml

_HEIGHT, _FRAME_HEIGHT = 520, 340
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


def frames(capture: Path) -> list[np.ndarray]:
    """White light, a coarse Gray code and a fringe, as the camera saw them, BGR."""
    listing = yaml.safe_load((capture / "capture.yaml").read_text(encoding="utf-8"))["frames"]

    def first(**wanted: object) -> np.ndarray:
        file = next(entry["file"] for entry in listing if wanted.items() <= entry["pattern"].items())
        image = cv2.imread(str(capture / file), cv2.IMREAD_COLOR)
        assert image is not None
        return image

    return [first(kind="white"), first(kind="gray", axis="x", bit=3), first(kind="phase", axis="y")]


def beside(every: list[np.ndarray], height: int) -> np.ndarray:
    """Pictures side by side, all of one height."""
    sizes = [(round(picture.shape[1] * height / picture.shape[0]), height) for picture in every]
    return np.hstack(
        [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture, size in zip(every, sizes, strict=True)]
    )


def write(name: str, picture: np.ndarray) -> None:
    """Write a picture into docs/images/."""
    target = Path(__file__).parent / "images" / name
    target.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(target), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(target)


def main() -> None:
    """Write docs/images/<name of the result>.png, and the frames."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path, help="a result folder")
    result = parser.parse_args().result
    faces, oblique, *_ = pictures(result / "report.html")
    write(f"{result.name}.png", beside([faces, oblique], _HEIGHT))
    write("first-scan-frames.png", beside(frames(result / "capture"), _FRAME_HEIGHT))


if __name__ == "__main__":
    main()
