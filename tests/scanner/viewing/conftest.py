"""A result folder, and the cloud of its capture as the viewer reads it."""

import pytest

from scanner.viewing.result import CaptureCloud, ViewedResult
from tests.support.result_folder import Written, write_result


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("viewing") / "room")


@pytest.fixture(scope="module")
def cloud(written: Written) -> CaptureCloud:
    shown = ViewedResult(written.folder).cloud("The capture")
    assert isinstance(shown, CaptureCloud)
    return shown
