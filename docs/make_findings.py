"""Write the tables of findings in docs/troubleshooting.md from the code:  python docs/make_findings.py

A kind of finding is declared once, as `NAME = FindingKind(...)` beside the code that finds it; a test fails while the
page is stale.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_TOP = Path(__file__).parent.parent
TARGET = Path(__file__).parent / "troubleshooting.md"
_BEGIN = "<!-- Written by docs/make_findings.py from the code: change the kinds there, and run it again. -->"
_END = "<!-- End of what docs/make_findings.py writes. -->"
_HEADER = "|kind |what it means |what to do |numbers |\n|--- |--- |--- |--- |"
# Titles of what finds, in the order of a scan, by folder or module; all kinds of a folder stand in one table.
_TITLES = {
    "scanner/checking": "`scan check`",
    "scanner/commands": "Devices",
    "scanner/capture": "Captures and recordings",
    "scanner/recordings": "Films",
    "scanner/decoding": "Decoding",
    "calib/plane_segmentation": "Faces",
    "calib/diagnostics": "Calibration from a corner",
    "scanner/reconstruction": "Reconstruction",
    "calib/boards": "Printed boards",
    "scanner/photos": "Photos",
    "calib/rooms": "Rooms and things",
    "calib/scene": "Calibration without a corner",
    "calib/networks": "Networks",
    "scanner/live": "Live clouds",
    "scanner/measuring": "Measurements and exports",
}
_WITH = {
    "scanner/acquisition.py": "scanner/capture",
    "scanner/jobs.py": "scanner/capture",
    "calib/refusal.py": "calib/diagnostics",
    "calib/numerics": "calib/diagnostics",
    "calib/refinement": "calib/diagnostics",
    "calib/self_calibration": "calib/diagnostics",
    "calib/objects": "calib/rooms",
    "calib/registration": "calib/rooms",
    "calib/estimation": "calib/rooms",
    "scanner/boards": "calib/boards",
    "scanner/rooms": "calib/rooms",
    "scanner/objects": "calib/rooms",
    "scanner/networks": "calib/networks",
    "scanner/exporting": "scanner/measuring",
}


@dataclass(frozen=True)
class DeclaredKind:
    """A kind as the code declares it: where, and its words."""

    path: str
    """Of the module, from the top of the repository."""
    name: str
    meaning: str
    remedy: str = ""
    data: tuple[str, ...] = ()


def declared_kinds() -> list[DeclaredKind]:
    """All kinds that the packages declare, by module and line. Raises ValueError for one that is no plain constant."""
    modules = (module for package in ("calib", "hw", "scanner") for module in sorted((_TOP / package).rglob("*.py")))
    return [kind for module in modules for kind in _kinds_in(module)]


def _kinds_in(module: Path) -> Iterator[DeclaredKind]:
    text, path = module.read_text(encoding="utf-8"), module.relative_to(_TOP).as_posix()
    if "FindingKind(" not in text:
        return
    tree = ast.parse(text)
    constants = {id(node.value) for node in tree.body if isinstance(node, ast.Assign)}
    texts = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "FindingKind"):
            continue
        if id(node) in constants:
            words = [_literal(argument, texts) for argument in node.args]
            named = {str(keyword.arg): _literal(keyword.value, texts) for keyword in node.keywords}
            yield DeclaredKind(path, *words, **named)
        elif path != "scanner/results/verdict.py":  # which reads kinds of any version
            raise ValueError(f"{path}:{node.lineno}: expected NAME = FindingKind(...) at the top of the module")


def _literal(node: ast.expr, texts: dict[str, ast.expr]) -> object:
    """The value of a literal, or of a constant of the module."""
    return ast.literal_eval(texts[node.id] if isinstance(node, ast.Name) else node)


def tables() -> str:
    """A table of the kinds of each part of the program."""
    parts: dict[str, list[DeclaredKind]] = {folder: [] for folder in _TITLES}
    for kind in declared_kinds():
        folder = "/".join(kind.path.split("/")[:2])
        parts[_WITH.get(folder, folder)].append(kind)
    return "\n".join(
        "\n".join([f"### {_TITLES[folder]}\n", _HEADER, *map(_row, kinds), ""])
        for folder, kinds in parts.items()
        if kinds
    )


def _row(kind: DeclaredKind) -> str:
    cells = f"`{kind.name}`", kind.meaning, kind.remedy, ", ".join(f"`{name}`" for name in kind.data)
    return "|" + " |".join(cell.replace("|", "\\|") for cell in cells) + "|"


def document() -> str:
    """All of docs/troubleshooting.md, with new tables."""
    before, _, rest = TARGET.read_text(encoding="utf-8").partition(_BEGIN)
    return f"{before}{_BEGIN}\n\n{tables()}\n{_END}{rest.partition(_END)[2]}"


def main() -> None:
    """Write the file."""
    TARGET.write_text(document(), encoding="utf-8")
    print(TARGET)


if __name__ == "__main__":
    main()
