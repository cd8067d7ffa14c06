"""Arguments that several commands have."""

from argparse import ArgumentParser
from pathlib import Path

REQUIRED_GRADES = ("good", "fair")  # the best first


def add_result(parser: ArgumentParser) -> None:
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder of a scan's result")


def add_capture(parser: ArgumentParser, otherwise: str = "all of them") -> None:
    add_number(parser, "--capture", f"one capture or station of several, by its number (default: {otherwise})")


def add_config(parser: ArgumentParser, *, required: bool) -> None:
    parser.add_argument("--config", type=Path, metavar="FILE", required=required, help="configuration (YAML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key, as in camera.width=640"
    )


def add_calibration(
    parser: ArgumentParser, text: str, *, kind: type[Path] | type[str] = Path, required: bool = False
) -> None:
    parser.add_argument("--calibration", type=kind, required=required, metavar="FILE", help=text)


def add_paths(parser: ArgumentParser, name: str, metavar: str, text: str, *, nargs: str = "+") -> None:
    parser.add_argument(name, type=Path, nargs=nargs, metavar=metavar, help=text)


def add_text(parser: ArgumentParser, flag: str, metavar: str, text: str) -> None:
    parser.add_argument(flag, metavar=metavar, help=text)


def add_flag(parser: ArgumentParser, flag: str, text: str) -> None:
    parser.add_argument(flag, action="store_true", help=text)


def add_number(parser: ArgumentParser, flag: str, text: str, *, default: int | None = None) -> None:
    described = text if default is None else f"{text} (default: {default})"
    parser.add_argument(flag, type=int, default=default, metavar="N", help=described)


def add_out(
    parser: ArgumentParser, what: str = "folder to make", *, default: str | None = None, metavar: str = "DIR"
) -> None:
    text = what if default is None else f"{what} (default: {default})"
    parser.add_argument("--out", type=Path, metavar=metavar, required=default is None, help=text)


def add_overwrite(parser: ArgumentParser, what: str = "result of that name") -> None:
    add_flag(parser, "--overwrite", f"replace an earlier {what}")


def add_new_result(parser: ArgumentParser, *, default: str | None = None, graded: bool = True) -> None:
    add_out(parser, default=default)
    add_overwrite(parser)
    if graded:
        add_require(parser, "the result, which is kept, has a lower grade")
    add_quiet(parser)


def add_require(parser: ArgumentParser, otherwise: str) -> None:
    what = f"exit code 4 if {otherwise}"
    parser.add_argument("--require", choices=REQUIRED_GRADES, metavar="|".join(REQUIRED_GRADES), help=what)


def is_enough(grade: str | None, required: str | None) -> bool:
    """Whether a grade, None for none, is at least what is required, if anything is."""
    return required is None or grade in REQUIRED_GRADES[: 1 + REQUIRED_GRADES.index(required)]


def add_masks(parser: ArgumentParser) -> None:
    parser.add_argument("--masks", type=Path, metavar="DIR", help="three PNG of the camera's size, nonzero on a face")


def add_quiet(parser: ArgumentParser) -> None:
    add_flag(parser, "--quiet", "print nothing but errors")
