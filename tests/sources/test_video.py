"""Videos: the same frames and times by PyAV and by OpenCV; rotation, damage, what is cut off."""

import sys
from fractions import Fraction
from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

from tests.sources.filmed import RATE, colour_frames, cut, damage, film
from tests.sources.made import make_video
from tisfm.formats import FormatError
from tisfm.sources import FrameSource
from tisfm.sources.av_video import AvVideo
from tisfm.sources.frame_reader import BadFrame, RawFrame
from tisfm.sources.video import OpenCvVideo, open_video

ALL = slice(0, None, 1)
VARYING = [0, 0.033, 0.1, 0.15, 0.4, 0.42, 0.5, 1.0, 1.01, 1.5]


@pytest.fixture
def without_av(monkeypatch):
    monkeypatch.setattr("tisfm.sources.video.has_av", lambda: False)


@pytest.fixture(params=[AvVideo, OpenCvVideo])
def decoder(request):
    return request.param


KINDS = {
    "constant rate": {"name": "a.mp4"},
    "varying rate": {"name": "a.mp4", "times": VARYING},
    "varying rate, Matroska": {"name": "a.mkv", "times": VARYING},
    "late beginning": {"name": "a.mp4", "times": [5 + k / RATE for k in range(10)]},
    "transport stream": {"name": "a.ts"},
    "quarter turn": {"name": "a.mp4", "rotation": 90},
    "half turn": {"name": "a.mp4", "rotation": 180},
    "quarter turn back": {"name": "a.mp4", "rotation": -90},
    "ten bits": {"name": "a.mp4", "pixels": "yuv420p10le"},
    "all of 8 bits": {"name": "a.mp4", "colorspace": 1, "color_range": 2},
    "no loss, odd size": {"name": "a.mkv", "codec": "ffv1", "pixels": "bgr0"},
    "grey": {"name": "a.mkv", "codec": "ffv1", "pixels": "gray"},
    "MPEG-4": {"name": "a.avi", "codec": "mpeg4", "unit": Fraction(1, RATE)},
    "VP9": {"name": "a.webm", "codec": "libvpx-vp9"},
}


@pytest.mark.parametrize("kind", KINDS)
def test_both_decoders_give_the_same(tmp_path, kind):
    options = dict(KINDS[kind])
    frames = colour_frames(10)
    if "odd" in kind:
        frames = [frame[:47, :63] for frame in frames]
    path = film(tmp_path / options.pop("name"), frames, **options)
    ours, theirs = (list(video(str(path)).read(ALL)) for video in (AvVideo, OpenCvVideo))
    assert len(ours) == len(theirs) == 10
    for one, other in zip(ours, theirs, strict=True):
        assert (one.index, one.name) == (other.index, other.name)
        assert one.time == pytest.approx(other.time, abs=1e-3)
        # FFmpeg's own conversion differs by a grey level from one of its versions to the next.
        assert one.image.shape == other.image.shape
        assert np.abs(one.image.astype(int) - other.image).max() <= 2


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_times_are_those_of_the_file(tmp_path, decoder, name):
    path = film(tmp_path / name, colour_frames(10), VARYING)
    times = [frame.time for frame in decoder(str(path)).read(ALL)]
    np.testing.assert_allclose(times, VARYING, atol=1e-6)


@pytest.mark.parametrize("rotation", [90, 180, -90])
def test_a_rotated_video_is_upright(tmp_path, decoder, rotation):
    frames = colour_frames(3)
    path = film(tmp_path / "turned.mp4", frames, rotation=rotation)
    plain = film(tmp_path / "plain.mp4", frames)
    pairs = zip(decoder(str(path)).read(ALL), decoder(str(plain)).read(ALL), strict=True)
    for turned, frame in pairs:
        np.testing.assert_array_equal(turned.image, np.rot90(frame.image, rotation // 90))


def test_colours_are_red_green_blue(tmp_path, decoder):
    frames = colour_frames(2)
    path = film(tmp_path / "a.mkv", frames, codec="ffv1", pixels="bgr0")
    for found, frame in zip(decoder(str(path)).read(ALL), frames, strict=True):
        np.testing.assert_array_equal(found.image, frame)
        assert found.image.flags.c_contiguous


@pytest.mark.parametrize("chosen", [slice(0, 7, 1), slice(3, None, 2), slice(2, 9, 3)], ids=str)
def test_chosen_frames(tmp_path, decoder, chosen):
    path = film(tmp_path / "a.mp4", colour_frames(10))
    every = list(decoder(str(path)).read(ALL))
    for found, frame in zip(decoder(str(path)).read(chosen), every[chosen], strict=True):
        assert (found.index, found.name, found.time) == (frame.index, frame.name, frame.time)
        np.testing.assert_array_equal(found.image, frame.image)


@pytest.mark.parametrize("found", [None, "16.1.0", "unknown"])
def test_the_installed_library_decodes(tmp_path, monkeypatch, found):
    def installed(name):
        if found is None:
            raise PackageNotFoundError(name)
        return found

    path = str(film(tmp_path / "a.mp4", colour_frames(3)))
    assert isinstance(open_video(path), AvVideo)
    monkeypatch.setattr("tisfm.sources.video.version", installed)
    monkeypatch.setitem(sys.modules, "av", None)  # any import of it fails
    assert isinstance(open_video(path), OpenCvVideo)


def test_formats_of_opencv_alone_are_read_by_opencv(tmp_path, monkeypatch):
    path = film(tmp_path / "a.mp4", colour_frames(3))

    def refuse(self, path):
        raise ValueError("of no known format")

    monkeypatch.setattr(AvVideo, "__init__", refuse)
    assert isinstance(open_video(str(path)), OpenCvVideo)


@pytest.mark.parametrize("name", ["a.txt", "a.mp4", "a"])
def test_a_text_is_refused_as_a_video(tmp_path, decoder, name):
    (tmp_path / name).write_text("no video\n" * 20)
    with pytest.raises(ValueError):
        decoder(str(tmp_path / name))


# Damage


def long_film(tmp_path, name="a.mp4"):
    """Two seconds, of which every twelfth frame stands by itself."""
    return film(tmp_path / name, colour_frames(60, 96, 128), options={"g": "12"})


@pytest.mark.parametrize("amount", [40, 2000], ids=["decodes", "does not"])
def test_damage_ends_with_the_next_key_frame(tmp_path, amount):
    """Frames keep their numbers, whatever is lost before them."""
    path = long_film(tmp_path)
    whole = list(AvVideo(str(path)).read(ALL))
    damage(path, amount)
    frames = list(AvVideo(str(path)).read(ALL))
    assert [frame.index for frame in frames] == list(range(60))
    bad = [frame.index for frame in frames if isinstance(frame, BadFrame)]
    assert bad == list(range(bad[0], bad[-1] + 1)) and (bad[-1] + 1) % 12 == 0
    for frame in frames[bad[-1] + 1 :]:
        assert isinstance(frame, RawFrame) and frame.time == whole[frame.index].time
        np.testing.assert_array_equal(frame.image, whole[frame.index].image)


def test_a_damaged_frame_is_named(tmp_path):
    path = long_film(tmp_path)
    damage(path, 2000)
    bad = [frame for frame in AvVideo(str(path)).read(ALL) if isinstance(frame, BadFrame)]
    with pytest.raises(FormatError, match=rf"frame {bad[0].index} of .*a\.mp4 cannot be decoded"):
        list(FrameSource(path))
    source = FrameSource(path, bad_frames="skip")
    found = [frame.index for frame in source.frames()]
    assert found == sorted(set(range(60)) - {frame.index for frame in bad})
    assert source.skipped == [(frame.index, str(frame.error)) for frame in bad]
    assert "is predicted from a damaged one" in source.skipped[-1][1]


def test_a_rate_that_varies_is_not_taken_for_a_cut(tmp_path, decoder):
    """OpenCV announces 46 frames for these ten."""
    path = film(tmp_path / "a.mkv", colour_frames(10), VARYING)
    assert len(list(decoder(str(path)).read(ALL))) == 10


@pytest.mark.parametrize("name", ["a.mkv", "a.avi"])
def test_a_truncated_video_is_an_error_at_its_end(tmp_path, decoder, name):
    codec = "mjpeg" if name == "a.avi" else "libx264"
    pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    path = film(tmp_path / name, colour_frames(60), codec=codec, pixels=pixels)
    cut(path, 0.6)
    with pytest.raises(ValueError, match=r"ends after \d+ .*cut off or damaged"):
        list(decoder(str(path)).read(ALL))
    found = list(decoder(str(path)).read(slice(0, 10, 1)))
    assert len(found) == 10  # none of these is missing


def test_a_source_without_pyav(tmp_path, without_av):
    path = tmp_path / "a.avi"
    make_video(path, "MJPG")
    frames = list(FrameSource(path).frames())
    assert [frame.time for frame in frames] == pytest.approx([k / 10 for k in range(6)])
