"""Which files of a folder are the frames, and in which order."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scanner.errors import InputError
from scanner.importing import find_frames


def touch(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return folder


def names(folder: Path, pattern: str | None = None) -> list[str]:
    return [path.name for path in find_frames(folder, pattern).numbered]


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    numbers=st.sets(st.integers(0, 3000), min_size=3, max_size=30),
    digits=st.integers(1, 5),
    prefix=st.sampled_from(["", "cam_", "IMG_2024-", "left 3 im"]),
    suffix=st.sampled_from([".png", ".JPG", ".tif"]),
)
def test_frames_are_ordered_by_their_numbers(
    tmp_path_factory: pytest.TempPathFactory, numbers: set[int], digits: int, prefix: str, suffix: str
) -> None:
    folder = tmp_path_factory.mktemp("frames")
    expected = [f"{prefix}{number:0{digits}d}{suffix}" for number in sorted(numbers)]
    touch(folder, *reversed(expected), "notes.txt", ".0001.png")
    assert names(folder) == expected


def test_the_only_folder_with_images_is_used(tmp_path: Path) -> None:
    touch(tmp_path, "readme.md", "overview.jpg")
    touch(tmp_path / "calibration")
    touch(tmp_path / "frames", "1.png", "2.png", "10.png")
    assert names(tmp_path) == ["1.png", "2.png", "10.png"]


def test_white_and_black_may_have_other_names(tmp_path: Path) -> None:
    touch(tmp_path, "im1.png", "im2.png", "im3.png", "all-White.png", "black.png", "color.png")
    found = find_frames(tmp_path)
    assert [found.white and found.white.name, found.black and found.black.name] == ["all-White.png", "black.png"]
    assert [path.name for path in found.left_out] == ["color.png"]
    assert str(found) == "3 frames, im1.png to im3.png and all-White.png and black.png"


def test_names_that_differ_in_several_numbers_are_one_series(tmp_path: Path) -> None:
    files = [f"1481302{49 + 2 * n}.5_[00-{10 - n:02d}-00_{n:02d}]_img.jpg" for n in range(11)]
    assert names(touch(tmp_path, *files)) == files


@pytest.mark.parametrize(
    "form",
    [
        "2024-05-01 12.{:02d}.{:02d}.png",
        "IMG_20240501_11{:02d}{:02d}.jpg",
        "Screenshot 2024-05-01 at 12.{:02d}.{:02d}.png",
    ],
)
def test_time_stamped_names_are_one_series(tmp_path: Path, form: str) -> None:
    """The last numbers differ in range from minute to minute."""
    files = [form.format(second // 60, second % 60) for second in range(7, 300, 13)]
    assert names(touch(tmp_path, *files, "notes 2024.txt")) == files


def test_copies_of_a_name_follow_it(tmp_path: Path) -> None:
    files = ["frame.png", *(f"frame ({number}).png" for number in range(1, 12))]
    assert names(touch(tmp_path, *files, "other.png")) == files
    assert names(touch(tmp_path / "others", "frame1.png", "frame2.png", "frame3.png", "frame.png")) == [
        "frame1.png", "frame2.png", "frame3.png"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({}, "expected the frames of a capture, found 0 images"),
        ({"": ["1.png", "2.png"]}, "expected the frames of a capture, found 2 images"),
        (
            {"": ["a.png", "b.png", "c.png"]},
            "series of at least 3 numbered images, found 3 images (a.png, b.png, c.png)",
        ),
        ({"one": ["1.png", "2.png", "3.png"], "two": ["1.png", "2.png", "3.png"]}, "found several folders of images"),
        (
            {"": [f"cam{camera}_im{n}.png" for camera in (1, 2) for n in range(4)]},
            "found several series: 4 frames, cam1_im0.png to cam1_im3.png; 4 frames, cam2_im0.png",
        ),
    ],
)
def test_folders_without_exactly_one_capture_are_refused(
    tmp_path: Path, files: dict[str, list[str]], said: str
) -> None:
    for place, inside in files.items():
        touch(tmp_path / place, *inside)
    with pytest.raises(InputError) as refused:
        find_frames(tmp_path)
    assert said in str(refused.value)


def test_one_of_two_cameras_is_chosen_by_name(tmp_path: Path) -> None:
    touch(tmp_path, *(f"cam{camera}_im{n}.png" for camera in (1, 2) for n in range(4)))
    assert names(tmp_path, "cam2_*") == [f"cam2_im{n}.png" for n in range(4)]


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found nothing"):
        find_frames(tmp_path / "none")
    with pytest.raises(InputError, match="found a file"):
        find_frames(touch(tmp_path, "x.png") / "x.png")
