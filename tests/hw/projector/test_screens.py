import pytest

from hw.errors import DeviceError
from hw.projector.screens import Screen, choose_screen

DESK = Screen(0, "eDP-1", 0, 0, 1920, 1080, 60.0)
BEAMER = Screen(1, "HDMI-1", 1920, 0, 1280, 720, 59.94)
TWIN = Screen(2, "HDMI-2", 3200, 0, 1280, 720, None)


@pytest.mark.parametrize("wanted", [1, "HDMI-1", "1280x720+1920+0", None])
def test_a_screen_is_found(wanted: int | str | None) -> None:
    assert choose_screen([DESK, BEAMER], wanted, (1280, 720)) == BEAMER


@pytest.mark.parametrize(
    ("screens", "wanted", "size", "words"),
    [
        (
            [DESK],
            None,
            (1280, 720),
            ("no screen is a screen of the projector's size, 1280 × 720", "eDP-1", "rig's screen"),
        ),
        ([DESK, BEAMER, TWIN], None, (1280, 720), ("2 screens", "HDMI-1", "HDMI-2")),
        (
            [DESK, BEAMER],
            2,
            (1280, 720),
            ("no screen is called 2", "screen 1 'HDMI-1', 1280x720+1920+0, 59.94 Hz"),
        ),
        ([DESK, BEAMER], "HDMI-2", (1280, 720), ("called 'HDMI-2'",)),
        ([DESK, BEAMER], "1280x720+0+0", (1280, 720), ("called '1280x720+0+0'",)),
        ([DESK, BEAMER], 0, (1280, 720), ("eDP-1", "is not 1280 × 720", "never scaled", "height of the patterns")),
        ([], None, (1280, 720), ("There are: none",)),
    ],
)
def test_an_ambiguous_screen_is_refused(
    screens: list[Screen], wanted: int | str | None, size: tuple[int, int], words: tuple[str, ...]
) -> None:
    with pytest.raises(DeviceError) as caught:
        choose_screen(screens, wanted, size)
    for word in words:
        assert word in str(caught.value)
