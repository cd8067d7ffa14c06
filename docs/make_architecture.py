"""Draw docs/images/architecture.png from the import contracts and the folders' own sentences.

python docs/make_architecture.py
"""

import ast
import textwrap
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

_ROOT = Path(__file__).parents[1]
_TARGET = Path(__file__).parent / "images" / "architecture.png"
# The way of a frame, as in architecture.md.
_WAY = {
    "hw/timing": 1,
    "scanner/capture": 2,
    "scanner/decoding": 3,
    "calib/plane_segmentation": 4,
    "calib/self_calibration": 5,
    "scanner/reconstruction": 6,
    "scanner/results": 7,
    "scanner/reporting": 8,
}
_COLUMNS = {"scanner": (0.0, 9.8, "#e8f1fa"), "hw": (10.3, 9.0, "#fdf3e1"), "calib": (19.8, 7.6, "#eaf5ea")}
_GAP, _HEIGHT = 0.12, 15.0


def floors(package: str) -> list[list[str]]:
    """The folders and files of each layer of a package, the topmost first."""
    contracts = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    for contract in contracts:
        if contract.get("containers") == [package]:
            return [[name.strip() for name in layer.replace("|", ":").split(":")] for layer in contract["layers"]]
    raise SystemExit(f"pyproject.toml has no layers for {package}")


def sentence(place: Path) -> str:
    """What a folder or file knows: the first sentence of its docstring."""
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    told = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return " ".join(told.split("\n\n")[0].split())


def draw(axes: Axes, package: str) -> None:
    """A package as a house of floors."""
    left, width, colour = _COLUMNS[package]
    rows = floors(package)
    height = _HEIGHT / len(rows)
    axes.text(left, _HEIGHT + 0.25, f"{package}/", fontsize=15, weight="bold", va="bottom")
    for number, row in enumerate(rows):
        share = (width - _GAP * (len(row) - 1)) / len(row)
        for column, name in enumerate(row):
            x, y = left + column * (share + _GAP), _HEIGHT - (number + 1) * height + _GAP / 2
            box = FancyBboxPatch(
                (x, y),
                share,
                height - _GAP,
                boxstyle="round,pad=0,rounding_size=0.08",
                facecolor=colour,
                edgecolor="#667",
            )
            axes.add_patch(box)
            place = f"{package}/{name}"
            path = _ROOT / place
            axes.text(
                x + 0.12,
                y + height - 0.3,
                name,
                fontsize=10 if len(name) * 0.18 < share else 6.6,
                weight="bold",
                va="center",
            )
            most = max(1, int((height - 0.45) / 0.24))
            wrapped = textwrap.wrap(sentence(path), max(10, int(share * 8.2)))
            lines = wrapped if len(wrapped) <= most else [*wrapped[: most - 1], f"{wrapped[most - 1]} …"]
            axes.text(
                x + 0.12, y + height - 0.5, "\n".join(lines), fontsize=7.6, va="top", color="#333", linespacing=1.15
            )
            if place in _WAY:
                axes.text(
                    x + share - 0.2,
                    y + height - 0.32,
                    str(_WAY[place]),
                    fontsize=9,
                    color="white",
                    ha="center",
                    va="center",
                    bbox={"boxstyle": "circle,pad=0.25", "facecolor": "#b5402a", "edgecolor": "none"},
                )


def main() -> None:
    """Draw all three."""
    figure, axes = plt.subplots(figsize=(19, 15.5))
    for package in _COLUMNS:
        draw(axes, package)
    axes.text(
        0,
        -0.25,
        "What is above may import what is below and what stands to the right, never the other way. "
        "The numbers are the way of a frame.",
        fontsize=10,
        va="top",
    )
    axes.set_xlim(-0.2, 27.6)
    axes.set_ylim(-0.8, _HEIGHT + 0.9)
    axes.axis("off")
    figure.savefig(_TARGET, dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main()
