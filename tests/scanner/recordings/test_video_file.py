"""A recording is one file in an allowed container: what it names is not opened, and reading it can be stopped."""

import io
import signal
import socket
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from scanner.errors import InputError
from scanner.interruption import handlers_restored, interrupt, on_ending
from scanner.recordings import video_file
from scanner.recordings.video_file import open_video, opened_film
from tests.support.command_line import run
from tests.support.room import FilmedRoom

FRAMES = 24
TICKS = 90_000  # to a second
SHOWN_S, LONGEST_S = 10.0, 140.0  # of the video that is filmed, and of a film of it


def write_film(path: Path, codec: str = "libx264", times_s: Iterable[float] | None = None) -> None:
    """Frames of noise, 64 × 48, in the container that the path's suffix names: FRAMES at 30 a second, or at times."""
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.bit_rate = 5_000_000
        if codec != "mpeg4":  # which has not so many bits for it
            stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        for time_s in np.arange(FRAMES) / 30 if times_s is None else times_s:
            image = rng.integers(0, 256, (48, 64), np.uint8)
            frame = av.VideoFrame.from_ndarray(image, "gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = round(time_s * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@contextmanager
def listening() -> Iterator[tuple[socket.socket, str]]:
    """A listener on 127.0.0.1 that must not be called, and its address."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        yield listener, f"127.0.0.1:{listener.getsockname()[1]}"


def was_called(listener: socket.socket) -> bool:
    try:
        listener.accept()[0].close()
    except BlockingIOError:
        return False
    return True


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("film.mp4", "libx264"),
        ("film.mov", "libx264"),
        ("film.mkv", "libx264"),
        ("film.avi", "mpeg4"),
        ("film.webm", "libvpx-vp9"),
    ],
)
def test_allowed_containers_are_read_whole(tmp_path: Path, name: str, codec: str) -> None:
    write_film(tmp_path / name, codec)
    # The name does not matter.
    (tmp_path / name).rename(tmp_path / "film")
    video = open_video(tmp_path / "film", SHOWN_S)
    assert video.size == (64, 48)
    frames = list(video.frames())
    assert len(frames) == FRAMES
    assert np.allclose(np.diff([time_s for time_s, _ in frames]), 1 / 30, atol=1.1e-3)


PLAYLISTS = {
    "live.m3u8": "#EXTM3U\n#EXTINF:1,\nhttp://{address}/part.ts\n",
    "whole.m3u8": "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nhttp://{address}/part.ts\n#EXT-X-ENDLIST\n",
    "tcp.m3u8": "#EXTM3U\n#EXTINF:1,\ntcp://{address}\n#EXT-X-ENDLIST\n",
    "list.ffconcat": "ffconcat version 1.0\nfile 'http://{address}/film.mp4'\n",
    "stream.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=-\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n",
    "film.mpd": '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="dynamic">'
    '<Period><AdaptationSet mimeType="video/mp4"><Representation id="1"><BaseURL>http://{address}/film.mp4</BaseURL>'
    "</Representation></AdaptationSet></Period></MPD>",
    "tcp:{address}": "#EXTM3U\n",
}


@pytest.mark.parametrize("name", PLAYLISTS)
@pytest.mark.parametrize("suffix", ["", ".mp4"])
def test_playlists_are_refused_and_nobody_is_called(
    filmed: FilmedRoom, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, suffix: str
) -> None:
    with listening() as (listener, address):
        path = tmp_path / (name.format(address=address) + suffix)
        path.write_text(PLAYLISTS[name].format(address=address), encoding="utf-8")
        assert run("import", path, "--sequence", filmed.sequence, "--out", tmp_path / "capture") == 2
        assert not was_called(listener)
    message = capsys.readouterr().err
    assert "of another kind" in message
    assert message.count("\n") == 1
    assert not (tmp_path / "capture").exists()


def with_external_data(film: bytes, address: str) -> bytes:
    """An MP4 file whose data reference (ISO/IEC 14496-12, 8.7.2) names an address instead of the file itself."""
    inside = struct.pack(">I4sI", 12, b"url ", 1)
    assert film.count(inside) == 1
    at = film.index(inside)
    location = f"http://{address}/film.mp4".encode() + b"\0"
    outside = struct.pack(">I4sI", 12 + len(location), b"url ", 0) + location
    changed = bytearray(film[:at] + outside + film[at + 12 :])
    for box in (b"moov", b"trak", b"mdia", b"minf", b"dinf", b"dref"):
        start = film.index(box) - 4
        struct.pack_into(">I", changed, start, struct.unpack_from(">I", film, start)[0] + len(location))
    return bytes(changed)


def test_references_to_other_films_are_not_followed(tmp_path: Path) -> None:
    write_film(tmp_path / "film.mp4")
    with listening() as (listener, address):
        path = tmp_path / "outside.mp4"
        path.write_bytes(with_external_data((tmp_path / "film.mp4").read_bytes(), address))
        assert len(list(open_video(path, SHOWN_S).frames())) == FRAMES
        assert not was_called(listener)


def test_even_a_playlist_could_open_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_file, "_CONTAINERS", (("hls", 0, (b"#EXTM3U",)),))
    with listening() as (listener, address):
        path = tmp_path / "whole.m3u8"
        path.write_text(PLAYLISTS["whole.m3u8"].format(address=address), encoding="utf-8")
        with pytest.raises(InputError, match=f"refers to 'http://{address}/part.ts'"):
            open_video(path, SHOWN_S)
        assert not was_called(listener)


def test_a_film_much_longer_than_its_video_is_refused_at_once(tmp_path: Path) -> None:
    write_film(tmp_path / "film.mp4", times_s=np.arange(0.0, 500.0 * FRAMES, 500.0))
    with pytest.raises(InputError, match=f"takes 11500 s or more, and its video 10 s; .* than {LONGEST_S:.0f} s"):
        open_video(tmp_path / "film.mp4", SHOWN_S)


def test_a_film_longer_than_it_states_is_refused_when_it_is_read(tmp_path: Path) -> None:
    # The muxer states the time of the last but one frame.
    write_film(tmp_path / "film.mp4", times_s=np.append(np.arange(FRAMES) / 30, 10_000.0))
    video = open_video(tmp_path / "film.mp4", SHOWN_S)
    read = list[object]()
    with pytest.raises(InputError, match="takes 10000 s or more"):
        read.extend(video.frames())
    assert len(read) == FRAMES


def test_frames_are_no_more_than_a_film_needs(tmp_path: Path) -> None:
    path, rate = tmp_path / "film.mp4", 15_000
    write_film(path, times_s=np.arange(3000.0) / rate)
    times = [time_s for time_s, _ in open_video(path, SHOWN_S).frames()]
    assert np.diff(times).min() > 0.99 * LONGEST_S / 100_000
    assert 130 < len(times) <= 3000 / rate * 100_000 / LONGEST_S + 1


def test_frames_too_large_for_the_memory_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "film.webm"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libvpx", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.options = {"g": "1"}  # key frames only, each with the size (RFC 6386, 9.1)
        for _ in range(FRAMES):
            container.mux(stream.encode(av.VideoFrame(64, 48, "yuv420p")))
        container.mux(stream.encode(None))
    start_code = b"\x9d\x01\x2a"
    honest, claimed = (start_code + struct.pack("<HH", *size) for size in ((64, 48), (16_000, 16_000)))
    assert path.read_bytes().count(honest) == FRAMES
    path.write_bytes(path.read_bytes().replace(honest, claimed))
    with pytest.raises(InputError, match="Invalid argument"):  # what libav says where it would not make such a frame
        open_video(path, SHOWN_S)


class Interrupted(io.BytesIO):
    """Bytes that somebody interrupts, by Ctrl-C or SIGTERM, while a piece of them is read."""

    def __init__(self, content: bytes, at: int, by: signal.Signals) -> None:
        super().__init__(content)
        self.pieces, self.at, self.by = 0, at, by

    def read(self, size: int | None = -1, /) -> bytes:
        self.pieces += 1
        if self.pieces == self.at:
            signal.raise_signal(self.by)
        return super().read(size)


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("at", [2, 4])
def test_an_interruption_ends_reading_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: signal.Signals, at: int
) -> None:
    write_film(tmp_path / "film.mp4")
    whole = (tmp_path / "film.mp4").read_bytes()
    file = Interrupted(whole, at, by)

    @contextmanager
    def opened(path: Path) -> Iterator[io.BytesIO]:
        yield file

    monkeypatch.setattr(video_file, "opened", opened)
    with handlers_restored():
        on_ending(interrupt)
        with pytest.raises(KeyboardInterrupt):
            open_video(tmp_path / "film.mp4", SHOWN_S)
    assert file.pieces == at


def test_a_film_without_frames_is_given_up(tmp_path: Path) -> None:
    write_film(tmp_path / "film.mp4")
    with opened_film(tmp_path / "film.mp4") as (_, film):
        film.waits_since -= video_file._LONGEST_WAIT_S
        with pytest.raises(InputError, match="no frame came in 60 s"):
            film.read(1)
