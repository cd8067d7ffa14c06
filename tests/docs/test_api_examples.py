"""The examples of docs/api.md run, and the listed names exist and are imported on demand."""

import re
import subprocess
import sys
from pathlib import Path

import calib
from tests.support.places import ROOT

PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_examples_run() -> None:
    assert len(EXAMPLES) >= 4
    names: dict[str, object] = {}
    for number, example in enumerate(EXAMPLES, start=1):
        exec(compile(example, f"docs/api.md, example {number}", "exec"), names)


def test_the_reference_lists_every_name() -> None:
    assert sorted(re.findall(r"^::: calib\.\w+\.(\w+)$", PAGE, flags=re.MULTILINE)) == calib.__all__
    typed = re.findall(
        r"^    from .* import (\w+) as \1$", Path(calib.__file__).read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    assert sorted(typed) == calib.__all__
    assert all(getattr(calib, name) is not None for name in calib.__all__)
    assert set(calib.__all__) < set(dir(calib))


def test_importing_the_package_imports_nothing_else() -> None:
    loaded = "import sys, calib; print([name for name in ('numpy', 'numba', 'cv2', 'scipy') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", loaded], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
