"""The last lines of a command, and `--require`."""

import pytest

from scanner.commands.outcome import conclude
from scanner.errors import GradeError
from scanner.results import Grade, Verdict
from scanner.ui import EXIT_REFUSED, Terminal, failure_of


@pytest.mark.parametrize(
    ("grade", "required", "enough"),
    [
        ("good", None, True),
        ("good", "good", True),
        ("good", "fair", True),
        ("fair", None, True),
        ("fair", "fair", True),
        ("fair", "good", False),
    ],
)
def test_a_grade_below_the_required_one_ends_with_its_exit_code(
    grade: Grade, required: str | None, enough: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    verdict = Verdict(grade, "Calibrated", ("because of this", "and this"))
    if enough:
        conclude(verdict, "look at it", Terminal(), required, 1)
    else:
        with pytest.raises(GradeError) as raised:
            conclude(verdict, "look at it", Terminal(), required, 1)
        failure = failure_of(raised.value)
        assert failure.exit_code == EXIT_REFUSED
        assert failure.message == "the result is fair, and --require good asks for better; it is kept"
    lines = capsys.readouterr().out.splitlines()
    assert lines == [f"{verdict.sign} Calibrated", "  because of this", "→ look at it"]
