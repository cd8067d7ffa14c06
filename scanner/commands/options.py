"""Arguments that several commands share."""

from argparse import ArgumentParser
from pathlib import Path


def add_config(parser: ArgumentParser, *, required: bool) -> None:
    """`--config FILE` and `--set KEY=VALUE`."""
    parser.add_argument("--config", type=Path, metavar="FILE", required=required, help="configuration (YAML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key, as in camera.width=640"
    )


def add_out(parser: ArgumentParser, *, default: str | None = None) -> None:
    """`--out DIR`, required unless there is a default."""
    text = "folder to make" if default is None else f"folder to make (default: {default})"
    parser.add_argument("--out", type=Path, metavar="DIR", required=default is None, help=text)


def add_overwrite(parser: ArgumentParser) -> None:
    """`--overwrite`."""
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier result of that name")


def add_masks(parser: ArgumentParser) -> None:
    """`--masks DIR`."""
    parser.add_argument("--masks", type=Path, metavar="DIR", help="three PNG of the camera's size, nonzero on a face")


def add_quiet(parser: ArgumentParser) -> None:
    """`--quiet`."""
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def default_path(result: Path, ending: str) -> Path:
    """Beside the result, named after it: a result folder itself stays as the scan left it."""
    folder = result.resolve()
    name = f"{folder.name}{ending}"
    return folder.parent / name if result.name in ("", ".", "..") else result.parent / name
