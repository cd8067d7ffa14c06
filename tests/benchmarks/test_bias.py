"""The benchmark that switches the decoder's corrections off, one by one."""

from bench_bias import SWITCHED_OFF, switched_off


def test_every_correction_is_where_it_is_switched_off() -> None:
    """A name that the decoder no longer has raises AttributeError."""
    assert len(SWITCHED_OFF) > 5
    for names in SWITCHED_OFF.values():
        with switched_off(names):
            pass
