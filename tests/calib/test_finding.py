"""A finding is a value: its kind decides, its words are for people."""

from dataclasses import FrozenInstanceError

import pytest

from calib.finding import Finding, FindingKind, Severity, of_kinds, without_kinds

TOO_WARM = FindingKind("too-warm", "It is too warm.", "Open a window.", ("temperature_c", "rooms"))
TOO_LOUD = FindingKind("too-loud", "It is too loud.")
WARM = Finding(TOO_WARM, Severity.WARNING, "It is 31 °C.", "Open it.", {"temperature_c": 31.0, "rooms": (1, 2)})
LOUD = Finding(TOO_LOUD, Severity.NOTE, "It is loud.")


def test_words_are_the_message_and_what_to_do() -> None:
    assert str(WARM) == "It is 31 °C. Open it."
    assert str(LOUD) == "It is loud."


def test_kinds_of_one_name_are_equal_whatever_is_said_about_them() -> None:
    as_read = FindingKind("too-warm", "")
    assert as_read == TOO_WARM
    assert hash(as_read) == hash(TOO_WARM)
    assert as_read != FindingKind("too-cold", TOO_WARM.meaning, TOO_WARM.remedy, TOO_WARM.data)


def test_findings_are_chosen_by_kind_in_their_order() -> None:
    findings = [LOUD, WARM, LOUD]
    assert of_kinds(findings, TOO_LOUD) == (LOUD, LOUD)
    assert of_kinds(findings, TOO_WARM, TOO_LOUD) == (LOUD, WARM, LOUD)
    assert without_kinds(findings, TOO_LOUD) == (WARM,)


def test_only_declared_numbers_are_taken() -> None:
    with pytest.raises(ValueError, match="too-warm declares no humidity"):
        Finding(TOO_WARM, Severity.NOTE, "It is humid.", data={"temperature_c": 31.0, "humidity": 0.9})


def test_numbers_are_those_of_a_name() -> None:
    assert WARM.numbers("rooms") == (1, 2)
    assert WARM.numbers("temperature_c") == ()
    assert WARM.number("temperature_c") == 31
    with pytest.raises(KeyError, match="several numbers"):
        WARM.number("rooms")
    with pytest.raises(KeyError):
        LOUD.number("temperature_c")
    assert LOUD.numbers("rooms") == ()


def test_a_finding_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        LOUD.message = "It is cold."  # type: ignore[misc]
