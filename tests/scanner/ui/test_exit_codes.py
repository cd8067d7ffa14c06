"""Errors become exit codes and messages."""

import threading

import cv2
import numpy as np
import pytest

from calib.finding import FindingKind
from calib.refusal import RefusalError
from hw.errors import DeviceError
from scanner.errors import InputError, StorageError
from scanner.ui import failure_of
from tests.support.little_memory import little_memory

KIND = FindingKind("unfit", "It is unfit.", "Take another one.")


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("no file"), 2, "no file"),
        (FileNotFoundError(2, "No such file", "a.yaml"), 2, "a.yaml"),
        (OSError(28, "No space left on device"), 3, "No space"),
        (StorageError("the disk is full"), 3, "the disk is full"),
        (DeviceError("the camera is gone"), 3, "the camera is gone"),
        (RefusalError(KIND, "It is unfit.", "Take another one."), 4, "no trustworthy"),
        (MemoryError("3 GB"), 2, "there is not enough memory for an input of this size: 3 GB"),
        (ImportError("libopenblas.so: failed to map segment from shared object"), 2, "there is not enough memory"),
        (ImportError("No module named 'scanner.rooom'"), 70, "a bug in this program: ImportError"),
        (RuntimeError("can't start new thread"), 2, "ulimit -v"),
        (RuntimeError("dictionary changed size during iteration"), 70, "a bug in this program: RuntimeError"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (ZeroDivisionError("by 0"), 70, "a bug in this program: ZeroDivisionError: by 0"),
    ],
)
def test_each_kind_of_error_has_its_exit_code(error: BaseException, code: int, words: str) -> None:
    failure = failure_of(error)
    assert failure.exit_code == code
    assert words in failure.message


def test_a_thread_that_the_system_refuses_is_no_bug() -> None:
    """As the interpreter says it; what was kept is named beside it."""
    end, threads = threading.Event(), list[threading.Thread]()

    def start_threads() -> None:
        while True:
            threads.append(threading.Thread(target=end.wait))
            threads[-1].start()

    with little_memory(), pytest.raises(RuntimeError) as caught:
        start_threads()
    end.set()
    for thread in threads[:-1]:
        thread.join()
    caught.value.add_note("19 frames are kept.")
    failure = failure_of(caught.value)
    assert failure.exit_code == 2
    assert failure.message.startswith("the system allows no further thread")
    assert failure.message.endswith("\n19 frames are kept.")
    assert 1 < len(threads) < 1000


def test_opencv_without_memory_is_no_bug() -> None:
    image = np.zeros((1000, 1000), np.uint8)
    with little_memory(), pytest.raises(cv2.error) as caught:
        cv2.resize(image, (30_000, 30_000))
    failure = failure_of(caught.value)
    assert failure.exit_code == 2
    assert failure.message.startswith("there is not enough memory for an input of this size")


def test_another_error_of_opencv_is_a_bug() -> None:
    with pytest.raises(cv2.error) as caught:
        cv2.resize(np.zeros((0, 0), np.uint8), (2, 2))
    assert failure_of(caught.value).exit_code == 70
