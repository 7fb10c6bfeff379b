"""Videos, as OpenCV reads them, and what is to be seen in them."""

import json
import sys

import cv2
import numpy as np
import pytest

from tests.exports.made import SHAPE, made, picture, ramp
from tests.exports.runs import run_of
from tisfm.cli.command_line import main
from tisfm.exports import PairFrames, SequenceFrames, write_video
from tisfm.exports.frame_maps import inverse_depth_ranges
from tisfm.exports.video_file import video_file
from tisfm.show import depth_to_color

pytest.importorskip("av")
H, W = SHAPE
EVEN = (H + 1, W + 1)
KINDS = ("depth", "side-by-side", "anaglyph", "wiggle")


def read(path):
    """Return the frames of a video, RGB, and how many there are in a second."""
    capture, frames = cv2.VideoCapture(str(path)), []
    while (found := capture.read())[0]:
        frames.append(found[1][..., ::-1].astype(int))
    rate = capture.get(cv2.CAP_PROP_FPS)
    assert int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) == len(frames)
    return frames, rate


def blurred(image):
    return cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)


@pytest.mark.parametrize("kind", KINDS)
def test_others_read_them(tmp_path, kind):
    frames = SequenceFrames(made(tmp_path / "walk"))
    told = []
    write_video(
        frames, tmp_path / "a.mp4", kind, frames_per_second=12.5, chosen=range(1, 6),
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip
    found, rate = read(tmp_path / "a.mp4")
    assert len(found) == 5 and rate == pytest.approx(12.5) and told[-1] == (5, 5)
    width = 2 * W if kind == "side-by-side" else EVEN[1]
    assert {frame.shape for frame in found} == {(EVEN[0], width, 3)}


def test_browsers_play_them(tmp_path):
    import av

    write_video(SequenceFrames(made(tmp_path / "walk")), tmp_path / "a.mp4", "depth")
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264" and stream.pix_fmt == "yuv420p"
        assert (stream.codec_context.colorspace, stream.codec_context.color_range) == (1, 1)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # they begin before all is there


def test_colours_are_those_that_were_drawn(tmp_path):
    drawn = picture(0, (64, 96))
    with video_file(tmp_path / "a.mp4", 25) as video:
        for _ in range(3):
            video.add(drawn)
    for frame in read(tmp_path / "a.mp4")[0]:
        # Colours have half the resolution; OpenCV may take another matrix of them.
        assert np.abs(blurred(frame) - blurred(drawn)).mean() < 12


def test_one_range_serves_all(tmp_path):
    """Frame n is nearer than the one before by a tenth: so is its colour, if ranges are one."""
    frames = SequenceFrames(made(tmp_path / "walk"))
    limit = inverse_depth_ranges(frames, range(6))
    values = np.concatenate([ramp(k)[np.isfinite(ramp(k))] for k in range(6)])
    assert limit == {0: pytest.approx(np.percentile(values, 95), rel=0.01)}
    write_video(frames, tmp_path / "a.mp4", "depth")
    shown = [frame[10:20, 20:24].mean() for frame in read(tmp_path / "a.mp4")[0]]
    drawn = [depth_to_color(ramp(k), limit=limit[0])[10:20, 20:24].mean() for k in range(6)]
    assert shown == pytest.approx(drawn, abs=6) and (np.diff(shown) > 3).all()


def test_pieces_have_ranges_of_their_own(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk", piece=[0, 0, 0, 1, 1, -1]))
    limits = inverse_depth_ranges(frames, range(5))
    assert limits[1] > 1.1 * limits[0] > 0


def test_side_by_side_is_the_frame_and_its_depth(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk"))
    write_video(frames, tmp_path / "both.mp4", "side-by-side")
    write_video(frames, tmp_path / "depth.mp4", "depth")
    both, depth = (read(tmp_path / f"{name}.mp4")[0] for name in ("both", "depth"))
    left, right = both[2][:H, :W], both[2][:H, W : 2 * W]
    assert np.abs(blurred(left) - blurred(frames.picture(2))).mean() < 12
    assert np.abs(blurred(right) - blurred(depth[2][:H, :W])).mean() < 6


def test_half_written_videos_are_removed(tmp_path):
    file = tmp_path / "a.mp4"
    file.write_bytes(b"an earlier one")

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    frames = SequenceFrames(made(tmp_path / "walk"))
    with pytest.raises(KeyboardInterrupt):
        write_video(frames, file, "depth", progress=stop)
    assert file.read_bytes() == b"an earlier one"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "walk"]
    with pytest.raises(ValueError, match="would have no frame"), video_file(file, 25):
        pass
    assert file.read_bytes() == b"an earlier one"


def test_frames_of_a_video_have_one_size(tmp_path):
    with (
        pytest.raises(ValueError, match=r"a frame is \(6, 8\) but the first was \(8, 8\)"),
        video_file(tmp_path / "a.mp4", 25) as video,
    ):
        video.add(np.zeros((8, 8, 3), np.uint8))
        video.add(np.zeros((6, 8, 3), np.uint8))


def test_frames_without_depth_are_left_out(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk", with_depth=(0, 2, 3)))
    write_video(frames, tmp_path / "a.mp4", "depth")
    assert len(read(tmp_path / "a.mp4")[0]) == 3
    with pytest.raises(ValueError, match="has depth: reconstruct with --depth-of all"):
        write_video(frames, tmp_path / "b.mp4", "wiggle", chosen=[1])
    assert not (tmp_path / "b.mp4").exists()


def test_flow_is_of_pairs(tmp_path):
    with pytest.raises(ValueError, match="has no image motion"):
        write_video(SequenceFrames(made(tmp_path / "walk")), tmp_path / "a.mp4", "flow")
    frames = PairFrames(run_of(tmp_path / "run"))
    write_video(frames, tmp_path / "flow.mp4", "flow")
    found, rate = read(tmp_path / "flow.mp4")
    assert len(found) == len(frames) and rate == pytest.approx(10, rel=1e-3)  # by their times
    # All moves to the right, faster each time: red grows, and green and blue shrink.
    shown = [frame[4:-4, 4:-4].mean(axis=(0, 1)) for frame in found]
    assert (np.diff([colour[1] for colour in shown]) < 0).all()


def test_depth_of_pairs_is_in_multiples_of_their_mean(tmp_path):
    """Scales of pairs are of no meaning: one that is twice another looks the same."""
    frames = PairFrames(run_of(tmp_path / "run", scales=(1.0, 7.0, 0.2)))
    write_video(frames, tmp_path / "a.mp4", "depth")
    one, two, three = read(tmp_path / "a.mp4")[0]
    assert np.abs(one - two).max() <= 8 and np.abs(one - three).max() <= 8
    posed = PairFrames(run_of(tmp_path / "posed", scales=(1.0, 0.5, 0.2), posed=True))
    write_video(posed, tmp_path / "b.mp4", "depth")
    one, two, three = (frame.mean() for frame in read(tmp_path / "b.mp4")[0])
    assert one > two + 10 > three + 20


def test_the_camera_swings_there_and_back(tmp_path, monkeypatch):
    frames = SequenceFrames(made(tmp_path / "walk", count=24, shape=(40, 160)))
    monkeypatch.setattr(frames, "picture", lambda frame: picture(0, (40, 160)))
    monkeypatch.setattr(frames, "inverse_depth", lambda frame: ramp(0, (40, 160)))
    write_video(frames, tmp_path / "a.mp4", "wiggle", frames_per_second=20, disparity=0.05)
    found = [blurred(frame) for frame in read(tmp_path / "a.mp4")[0]]  # within 1.2 s
    apart = np.abs(found[6] - found[18]).mean()
    assert np.abs(found[0] - found[12]).mean() < 0.2 * apart
    assert np.abs(found[5] - found[7]).mean() < 0.2 * apart
    assert 0.3 * apart < np.abs(found[0] - found[6]).mean() < 0.7 * apart


def test_the_camera_swings_by_half_the_budget_to_either_side(tmp_path, monkeypatch):
    """A far and a near half, of stripes: how far these move apart is measured at the turns."""
    height, width = 40, 400
    depth = np.full((height, width), 1e-6, np.float32)
    depth[height // 2 :] = 1.0
    stripes = np.uint8(128 + 100 * np.sin(np.arange(width) / 6 + np.sin(np.arange(width) / 29)))
    frames = SequenceFrames(made(tmp_path / "walk", count=24, shape=(height, width)))
    monkeypatch.setattr(frames, "picture", lambda frame: np.tile(stripes, (height, 1)))
    monkeypatch.setattr(frames, "inverse_depth", lambda frame: depth)

    def swing(**options):
        write_video(frames, tmp_path / "a.mp4", "wiggle", frames_per_second=20, **options)
        found = read(tmp_path / "a.mp4")[0]

        def apart(frame):
            """How far the upper half lies to the right of the lower one, px."""
            far, near = (frame[rows, :, 1].mean(axis=0) for rows in (slice(5, 15), slice(25, 35)))
            shifts = range(-30, 31)
            off = [np.square(far[40 + k : width - 40 + k] - near[40:-40]).mean() for k in shifts]
            return shifts[int(np.argmin(off))]

        return apart(found[6]), apart(found[18])

    by_default, given = swing(), swing(disparity=0.03)
    assert given == (pytest.approx(12, abs=2), pytest.approx(-12, abs=2))  # 0.03 of 400
    assert by_default == (pytest.approx(6, abs=2), pytest.approx(-6, abs=2))


def test_a_still_swings_once(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk"))
    write_video(frames, tmp_path / "a.mp4", "wiggle", chosen=[3], frames_per_second=10)
    found = read(tmp_path / "a.mp4")[0]
    assert len(found) == 12 and np.abs(found[3] - found[9]).mean() > 2


@pytest.mark.parametrize("disparity", [0.0, -0.1, 0.3])
def test_no_eyes_follow_any_disparity(tmp_path, disparity):
    frames = SequenceFrames(made(tmp_path / "walk"))
    with pytest.raises(ValueError, match="expected a share of the width"):
        write_video(frames, tmp_path / "a.mp4", "wiggle", disparity=disparity)


def test_the_screen_is_one_plane_of_all_frames(tmp_path):
    """What lies in it has no parallax in any frame: quantile and depth say the same."""
    frames = SequenceFrames(made(tmp_path / "walk", shape=(40, 160)))
    values = np.concatenate([ramp(k, (40, 160)).ravel() for k in range(6)])
    for name, options in (
        ("quantile", {"screen": 0.25}),
        ("depth", {"screen_depth": 1 / np.nanquantile(values[values > 0], 0.25)}),
        ("nearest", {"screen": 1.0}),
        ("default", {}),
    ):
        write_video(frames, tmp_path / f"{name}.mp4", "anaglyph", disparity=0.1, **options)
    shown = {
        name: np.stack([blurred(frame) for frame in read(tmp_path / f"{name}.mp4")[0]])
        for name in ("quantile", "depth", "nearest", "default")
    }
    assert np.abs(shown["quantile"] - shown["depth"]).mean() < 2
    assert np.abs(shown["quantile"] - shown["nearest"]).mean() > 5
    assert np.abs(shown["quantile"] - shown["default"]).mean() > 3
    with pytest.raises(ValueError, match=r"screen is 0\.5 and screen_depth is 2: give one"):
        write_video(frames, tmp_path / "b.mp4", "wiggle", screen=0.5, screen_depth=2)


def test_videos_need_their_package(tmp_path, monkeypatch):
    frames = SequenceFrames(made(tmp_path / "walk"))
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"pip install 'tisfm\[video\]'"):
        write_video(frames, tmp_path / "a.mp4", "depth")


def test_a_note_tells_of_depth_with_an_unknown_status(tmp_path, capsys):
    folder = run_of(tmp_path / "run")
    record = json.loads((folder / "run.json").read_text())
    record["pairs"]["p1"]["status"] = "brand_new"
    (folder / "run.json").write_text(json.dumps(record))
    assert main(["export", str(folder), "--to", "depth-tiff", "-o", str(tmp_path / "o")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "1 frame with a status that this version does not know (brand_new): treat" in said


def test_damaged_runs(tmp_path):
    folder = run_of(tmp_path / "run")
    record = json.loads((folder / "run.json").read_text())
    (folder / "p1.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"no p1\.npz.* it was removed; run again"):
        PairFrames(folder)
    record["outputs"] = ["depth"]
    (folder / "run.json").write_text(json.dumps(record))
    with pytest.raises(FileNotFoundError, match=r"no p1\.npz.*--outputs left it out"):
        PairFrames(folder)
    out = {f"../{name}": pair for name, pair in record["pairs"].items()}
    for pairs, message in (
        ({}, "no complete pair"),
        ([], "damaged or of another kind"),
        (out, "is not the name of a pair"),
    ):
        (folder / "run.json").write_text(json.dumps({**record, "pairs": pairs}))
        with pytest.raises(ValueError, match=message):
            PairFrames(folder)
