"""A finding is a value: its kind decides, its words are for people."""

from dataclasses import FrozenInstanceError

import pytest

from calib.finding import Finding, FindingKind, Severity

TOO_WARM = FindingKind("too-warm", Severity.WARNING, "It is too warm.", "Open a window.", ("temperature_c", "rooms"))


def test_words_are_the_message_and_what_to_do() -> None:
    finding = Finding(TOO_WARM, "It is 31 °C.", "Open the window.", {"temperature_c": 31.0, "rooms": (1, 2)})
    assert str(finding) == "It is 31 °C. Open the window."
    assert str(Finding(TOO_WARM, "It is 31 °C.")) == "It is 31 °C."
    assert finding.severity is Severity.WARNING


def test_kinds_of_one_name_are_equal_whatever_is_said_about_them() -> None:
    as_read = FindingKind("too-warm", Severity.NOTE, "")
    assert as_read == TOO_WARM
    assert hash(as_read) == hash(TOO_WARM)
    assert as_read != FindingKind("too-cold", Severity.WARNING, TOO_WARM.meaning, TOO_WARM.remedy, TOO_WARM.data)


def test_only_declared_numbers_are_taken() -> None:
    with pytest.raises(ValueError, match="too-warm: declares no humidity"):
        Finding(TOO_WARM, "It is humid.", data={"temperature_c": 31.0, "humidity": 0.9})


def test_a_finding_cannot_be_changed() -> None:
    finding = Finding(TOO_WARM, "It is 31 °C.")
    with pytest.raises(FrozenInstanceError):
        finding.message = "It is cold."  # type: ignore[misc]
