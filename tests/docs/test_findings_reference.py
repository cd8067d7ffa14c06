"""The page of all findings is that of the code, and each kind is declared once."""

import re
from collections import Counter

from tests.docs.test_configuration_reference import module
from tests.support.places import ROOT

MAKER = module(ROOT / "docs" / "make_findings.py")
# Numbers without a unit end in what they count or compare.
ENDINGS = [
    "_share",
    "_ratio",
    "_percent",
    "_px",
    "_mm",
    "_ms",
    "_s",
    "_deg",
    "_grey_levels",
    "_widths",
    "_sigma",
    "_thousandths",
    "_less_likely",
    "_captures",
    "_frames",
    "_matches",
]
COUNTS = {
    *("frames", "captures", "bits", "faces", "matches", "points", "pixels", "planes", "views", "changes"),
    *("cost", "limit", "exponent"),
}


def test_the_page_matches_the_code() -> None:
    assert (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8") == MAKER.document(), (
        "docs/troubleshooting.md is stale: run python docs/make_findings.py"
    )


def test_each_kind_is_declared_once() -> None:
    counts = Counter(kind.name for kind in MAKER.declared_kinds())
    assert len(counts) > 100
    assert {name: count for name, count in counts.items() if count > 1} == {}


def test_kinds_say_what_they_mean_and_in_which_unit() -> None:
    kinds = MAKER.declared_kinds()
    assert [kind.name for kind in kinds if not re.fullmatch(r"[a-z]+(-[a-z]+)*", kind.name)] == []
    assert [kind.name for kind in kinds if not kind.meaning.endswith(".")] == []
    assert [kind.name for kind in kinds if kind.remedy and not kind.remedy.endswith(".")] == []
    numbers = {name for kind in kinds for name in kind.data}
    assert sorted(name for name in numbers if name not in COUNTS and not name.endswith(tuple(ENDINGS))) == []
