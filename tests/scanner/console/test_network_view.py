"""What the page shows of a network while it is captured, without a browser."""

from collections.abc import Iterator

import numpy as np
import pytest
import viser

from hw.rig import Frame
from scanner.console import network_view
from scanner.console.network_view import NetworkView
from scanner.console.worker import Activity, Status
from scanner.networks import PairProgress
from scanner.viewing import free_port


class Clock:
    now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture(scope="module")
def gui() -> Iterator[viser.GuiApi]:
    server = viser.ViserServer("127.0.0.1", free_port("127.0.0.1", None), verbose=False)
    yield server.gui
    server.stop()


def test_progress_by_projector_and_a_picture_of_every_camera(
    gui: viser.GuiApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(network_view, "time", clock)
    monkeypatch.setattr("scanner.console.texts.time", clock)
    view = NetworkView(gui, lambda **_: None, lambda _: None)
    progress, images, graph = view._progress, view._images, view._graph
    view.show(Status(Activity.NETWORK))
    for projector in ("stage", "side"):
        for camera in ("left", "right"):
            view.on_sight(PairProgress(camera, projector), None)
    assert progress.content == ""
    for done in range(1, 6):
        clock.now_s += 2.0
        for camera in ("left", "right"):  # captured together
            view.on_sight(PairProgress(camera, "stage", 10, done), Frame(np.full((6, 8), 20 * done, np.uint8)))
    view.tick()
    # 10 of 20 frames in the 8 s since the first.
    assert "stage, 10 of 20 frames, about 8 s left" in progress.content
    assert "side: waiting" in progress.content
    assert 'aria-label="side" max="20" value="0"' in progress.content
    assert images.content.count("<figure>") == 2
    for camera in ("left", "right"):
        assert f'alt="what {camera} sees"' in images.content
        assert f"{camera} in the light of stage" in images.content
    shown = images.content
    view.on_sight(PairProgress("right", "stage", 10, 6), Frame(np.zeros((6, 8), np.uint8)))
    assert images.content == shown, "more often than one can see"
    view.on_sight(PairProgress("left", "stage", 10, 10, 0.5), None)
    view.on_sight(PairProgress("right", "stage", 10, 6, failure="the <cable> is out"), None)
    view.show(Status())
    assert "stage, 16 of 20 frames</p>" in progress.content, "no time is left when nothing goes on"
    assert "right in the light of stage failed: the &lt;cable&gt; is out" in graph.content
