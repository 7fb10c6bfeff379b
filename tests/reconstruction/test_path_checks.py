"""Fixed pixels are masked, and image motion contradicts a path with a wrong camera."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import tisfm
from tests.exports.made import made
from tests.reconstruction.films import along, path_error
from tests.rendered import room_film
from tisfm.cli.reconstruct import _tell
from tisfm.errors import InputError
from tisfm.reconstruction.frames.image_motion import chain_flows
from tisfm.reconstruction.path_checks import dense_pairs, pieces
from tisfm.reconstruction.path_checks.dense_pairs import find_matching_pixels
from tisfm.reconstruction.path_checks.pieces import choose_second_frame
from tisfm.reconstruction.result.calibration import GIVEN
from tisfm.reconstruction.result.focal_note import find_focal_note
from tisfm.reconstruction.result.folder import FIXED_MASK
from tisfm.reconstruction.result.path_check import UNCHECKED, PairEvidence, PathCheck
from tisfm.reconstruction.result.statuses import mark_contradicted
from tisfm.reconstruction.streaming import stream_checks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.report.reconstruction_report import _report
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.status import Status
from tisfm.view.html_texts import status_html
from tisfm.view.static_page import _caption

FAST = tisfm.Settings.preset("fast", motion="camera")
COUNT, HEIGHT, WIDTH = 10, 120, 160
BAND = 18  # px: height of the overlay at the lower border


@cache
def film():
    """Return a film of a camera that turns and moves."""
    return room_film(along(COUNT, np.array((0.06, 0.01, 0.02, 0, 0.012, 0))), HEIGHT, WIDTH)


@cache
def with_overlay():
    """Return the frames of the film with a textured band that is fixed on the sensor."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, (BAND, WIDTH)), (0, 0), 2)
    frames = film().frames.copy()
    frames[:, -BAND:] = np.clip(120 + 50 * noise / noise.std(), 0, 255)
    return frames


def zoomed(rate):
    """Return the frames of the film with a zoom, a growing factor from frame to frame."""
    frames = []
    for number, frame in enumerate(film().frames):
        factor = 1 + rate * number
        shift = [(1 - factor) * (side - 1) / 2 for side in (WIDTH, HEIGHT)]
        matrix = np.float32([[factor, 0, shift[0]], [0, factor, shift[1]]])
        size = WIDTH, HEIGHT
        frames.append(cv2.warpAffine(frame, matrix, size, borderMode=cv2.BORDER_REFLECT))
    return np.stack(frames)


def reconstructed(frames, **options):
    options = {"camera": film().camera, "settings": FAST, "depth_of": "keyframes"} | options
    return tisfm.reconstruct(frames, **options)


def test_right_path_is_not_contradicted(tmp_path):
    result = reconstructed(film().frames, folder=tmp_path)
    (check,) = result.checks
    assert not check.contradicts and check.message == "" and result.mask is None
    assert set(result.status) == {"converged"}
    assert len(check.pairs) >= 2 and check.infinity_motion > 5
    assert tisfm.Reconstruction.load(tmp_path).checks == result.checks
    assert not (tmp_path / FIXED_MASK).exists()


def test_a_pair_is_checked_once(monkeypatch):
    """Two keyframes may be the best partners of each other."""
    monkeypatch.setattr(pieces, "choose_second_frame", lambda first, *_: first ^ 1)
    chosen = []
    monkeypatch.setattr(
        pieces, "check_pair", lambda first, second, *_: chosen.append((first, second))
    )
    monkeypatch.setattr(pieces, "check_with_pairs", lambda pairs, *_: pairs)
    poses = dict.fromkeys(range(6), np.eye(4))
    pieces.check_piece(
        poses, range(6), {}, lambda _: np.zeros((2, 3)), lambda _: None, lambda _: None, None
    )
    assert chosen and len({frozenset(pair) for pair in chosen}) == len(chosen)


def test_a_stream_checks_a_pair_once(monkeypatch):
    """Two frames may be the best partners of each other, in one call or in the next one."""
    monkeypatch.setattr(stream_checks, "choose_second_frame", lambda first, *_: first ^ 1)
    chosen = []
    monkeypatch.setattr(
        stream_checks, "check_pair", lambda first, second, *_: chosen.append((first, second))
    )
    monkeypatch.setattr(stream_checks, "check_with_pairs", lambda *_: made_check)
    made_check = PathCheck(pairs=(), fixed_share=0.0, infinity_motion=0.0)
    piece = SimpleNamespace(poses=dict.fromkeys(range(6), np.eye(4)))
    path = SimpleNamespace(select_recent=lambda piece: piece, observations={})
    frames = SimpleNamespace(
        grey=lambda _: np.zeros((2, 3)), static_pixels=lambda _: None, camera=None
    )
    checks = stream_checks.StreamChecks(path, frames)
    for first, last in ((0, 1), (2, 2), (3, 5)):
        checks.find_contradictions({0: piece, 7: piece}, first, last)
    pairs = [frozenset(pair) for pair in chosen]
    assert len(set(pairs)) == 3
    assert all(pairs.count(pair) == 2 for pair in pairs)  # once for each piece


OBJECTS = tisfm.Settings.preset("fast", motion="objects")


@pytest.mark.parametrize("options", [{}, {"settings": OBJECTS}, {"poses": True}])
def test_overlay_is_masked(tmp_path, options):
    if "poses" in options:
        options = {"poses": film().poses}
    result = reconstructed(with_overlay(), folder=tmp_path, **options)
    assert set(result.status) == {"converged"} and not result.objects
    assert path_error(result.poses, film().poses) < 0.01
    mask = tisfm.Reconstruction.load(tmp_path).mask
    np.testing.assert_array_equal(mask, result.mask)
    assert mask[-BAND:].mean() > 0.95 and mask[: -BAND - 4].mean() < 0.01
    assert np.isinf(result.inverse_depth_std(result.keyframes[0])[mask]).all()


def test_overlay_that_is_kept_contradicts_the_path():
    result = reconstructed(with_overlay(), fixed_pixels="keep")
    assert result.mask is None
    assert "contradicted" in result.status
    status = next(status for status in result.status if status == "contradicted")
    assert "fixed on the sensor" in status.message


def test_zoom_contradicts_the_path():
    rate = 0.01
    result = reconstructed(zoomed(rate), calibrate="nothing")
    assert set(result.status) == {"contradicted"}
    assert "focal length changes" in result.status[0].message
    assert result.checks[0].zoom[0] == pytest.approx(np.log1p(rate), abs=0.5 * rate)


def streamed_statuses(frames):
    stream = tisfm.reconstruct_stream(frames, camera=film().camera, settings=FAST, delay=8)
    return [frame.status for frame in stream]


def test_frames_of_a_stream_are_contradicted():
    statuses = streamed_statuses(zoomed(0.03))
    assert set(statuses) == {"contradicted"}
    assert "focal length changes" in statuses[0].message
    assert "fixed on the sensor" in streamed_statuses(with_overlay())[-1].message


def test_far_texture_is_not_fixed_on_the_sensor():
    # The upper half is far away: it stays at rest, because the camera only translates.
    camera = along(COUNT, np.array((0.06, 0.0, 0.0, 0, 0, 0)))
    frames = room_film(camera, HEIGHT, WIDTH).frames.copy()
    frames[:, : HEIGHT // 2] = frames[0, : HEIGHT // 2]
    assert reconstructed(frames).mask is None


def test_camera_at_rest_has_no_mask():
    noise = np.random.default_rng(0).normal(0, 2, (COUNT, HEIGHT, WIDTH))
    frames = np.clip(film().frames[:1] + noise, 0, 255).astype(np.uint8)
    result = reconstructed(frames)
    assert result.mask is None
    assert "converged" not in result.status


def test_an_unknown_value_is_refused():
    with pytest.raises(InputError, match="fixed_pixels"):
        reconstructed(film().frames, fixed_pixels="no")


GOOD = PairEvidence(
    first=0, second=1, excess=0.0, residual_ratio=1.0, direction=1.0, direction_deviation=1.0,
    rotation=0.0, behind=0.0, rank=0.9, zoom=0.0, zoom_deviation=0.001, zoom_gain=1.0,
    parallax=0.01, focal_value=0.0, focal_deviation=0.1, focal_depth=0.02, focal_direction=1.0,
    focal_rotation=0.5,
)  # fmt: skip


def check_of(fixed_share=0.0, infinity_motion=5.0, **changes):
    """Return the check of a path with one pair, whose evidence is good but for the changes."""
    if "zoom" in changes:
        changes = {"zoom_gain": 1.2} | changes
    pair = replace(GOOD, **changes)
    return PathCheck(pairs=(pair,), fixed_share=fixed_share, infinity_motion=infinity_motion)


def test_residual_factor_is_the_median_ratio_of_at_least_one():
    assert UNCHECKED.residual_factor == check_of(residual_ratio=0.9).residual_factor == 1
    pairs = tuple(replace(GOOD, residual_ratio=ratio) for ratio in (1.0, 3.0, 2.0))
    assert replace(UNCHECKED, pairs=pairs).residual_factor == 2


def test_a_zoom_that_does_not_lower_the_residual_is_no_objection():
    """Any zoom fits the motion of a plane."""
    assert check_of(zoom=0.01).objections == ("zoom",)
    assert not check_of(zoom=0.01, zoom_gain=1.01).objections


def test_a_sequence_that_depends_on_its_stated_focal_length_says_so():
    check = check_of(
        focal_deviation=0.3, focal_depth=0.02, focal_direction=40.0, focal_rotation=1.0
    )
    note = find_focal_note(GIVEN, [check])
    assert note.startswith("the result depends on the stated focal length")
    assert "direction of motion by up to 40°; check" in note
    assert not find_focal_note(replace(GIVEN, origin="estimated"), [check])
    shown = replace(check, pairs=check.pairs * 20)  # together, twenty pairs show the focal length
    assert check.focal_spread == pytest.approx(0.3) and shown.focal_spread < 0.1
    unknown = replace(check, pairs=tuple(replace(p, focal_deviation=0.5) for p in shown.pairs))
    assert unknown.focal_spread == pytest.approx(0.5)  # twenty pairs that know nothing
    pair = replace(check.pairs[0], focal_value=0.2, focal_deviation=0.1)
    off = replace(check, pairs=(pair,) * 20)
    assert off.focal_spread == pytest.approx(0.2, abs=0.01)  # they agree on another one
    assert not find_focal_note(GIVEN, [shown])
    assert not find_focal_note(GIVEN, [check_of(focal_deviation=0.3)])  # it changes little
    assert not find_focal_note(GIVEN, [])


def test_all_texts_of_a_result_have_the_note_on_the_focal_length(tmp_path, capsys):
    """The camera's file has no such note: another film with this camera may show it."""
    plain = made(tmp_path / "made", count=3)
    check = check_of(focal_deviation=0.3, focal_direction=40.0)
    replace(plain, checks=(check,)).save(tmp_path / "saved")
    result = tisfm.Reconstruction.load(tmp_path / "saved")
    note = result.focal_note
    assert "depends on the stated focal length" in note and not result.calibration.message
    assert note[1:] in result.summary() and plain.focal_note == ""
    assert note[:40] in dict(_report(result, tmp_path, None).summary)["Note on the focal length"]
    frames = SequenceFrames(result)
    assert _caption(frames, 3, []).endswith(note)
    assert note in status_html(frames, frames.read(0), 0)
    _tell(result, tmp_path)
    told = " ".join(capsys.readouterr().err.split())
    assert note in told and "focal length: " not in told


@pytest.mark.parametrize(
    ("changes", "objections", "contradicts"),
    [
        ({}, (), False),
        ({"excess": 0.06}, ("excess",), False),
        ({"residual_ratio": 1.7}, ("residual",), False),
        ({"direction": 9.0}, ("direction",), False),
        ({"direction": 9.0, "direction_deviation": 3.0}, (), False),
        ({"rank": 0.5}, ("rank",), False),
        ({"rank": None}, (), False),
        ({"behind": 0.1}, ("behind",), False),
        ({"excess": 0.06, "behind": 0.1}, ("excess", "behind"), True),
        ({"zoom": 0.01}, ("zoom",), True),
        ({"zoom": -0.01}, ("zoom",), True),
        ({"zoom": 0.01, "zoom_deviation": 0.0015}, ("zoom",), True),
        ({"zoom": 0.01, "zoom_deviation": 0.003}, (), False),
        ({"zoom": 0.002, "zoom_deviation": 1e-4}, (), False),
        ({"fixed_share": 0.03}, ("fixed",), True),
        ({"fixed_share": 0.03, "infinity_motion": 1.0}, (), False),
    ],
)
def test_evidence_beyond_its_limit_is_an_objection(changes, objections, contradicts):
    check = check_of(**changes)
    assert check.objections == objections
    assert check.contradicts == contradicts == bool(check.message)


def test_pairs_that_contradict_each_other_show_no_zoom():
    pairs = [replace(GOOD, zoom=z, zoom_deviation=0.005) for z in (0.06, 0.0, 0.07)]
    check = replace(check_of(), pairs=tuple(pairs))
    assert check.zoom[0] == 0.06 and check.objections == ()


def test_pairs_that_know_only_the_prior_show_no_zoom():
    """A camera that moves along its axis: the zoom of a pair is open, and the prior decides."""
    pair = replace(GOOD, zoom=0.06, zoom_deviation=0.029, zoom_gain=1.07)
    check = replace(check_of(), pairs=(pair,) * 5)
    assert 1 < check.zoom[1] < 2 and check.objections == ()
    open_pairs = (replace(pair, zoom_deviation=0.03), replace(pair, zoom_deviation=np.nan))
    assert replace(check, pairs=open_pairs).zoom == (0.0, 0.0)
    assert replace(check, pairs=open_pairs).objections == ()
    clear = replace(GOOD, zoom=0.015, zoom_deviation=0.001, zoom_gain=1.2)
    pairs = (clear, clear, *(replace(p, zoom=0.0, zoom_gain=1.0) for p in 2 * open_pairs))
    assert replace(check, pairs=pairs).zoom == replace(check, pairs=(clear, clear)).zoom
    assert replace(check, pairs=pairs).objections == ("zoom",)


def test_one_wrong_pair_is_a_doubt_without_depth():
    """It contradicts the path only beside a cause, such as noise that is fixed on the sensor."""
    good = replace(GOOD, rank=None)
    wrong = replace(good, first=3, second=7, excess=0.16, residual_ratio=3.0)
    check = replace(check_of(), pairs=(good, wrong, good))
    assert not check.contradicts
    assert check.doubt.startswith("the image motion between frames 3 and 7 contradicts the path: ")
    assert check.doubt.endswith("3.0 times that of another motion")
    zoomed = replace(wrong, zoom=0.05, zoom_deviation=0.002, zoom_gain=1.1)
    assert "grows" not in replace(check, pairs=(good, zoomed, good)).doubt
    joined = PathCheck.joined([replace(check, pairs=(good,)), check]).renumbered(
        {k: 10 + k for k in range(8)}
    )
    assert "part of the frames, 10 to 17: the image motion between frames 13 and 17" in joined.doubt
    assert not replace(check, pairs=(good, replace(wrong, excess=0.0), good)).doubt
    assert not replace(check, pairs=(GOOD, replace(wrong, rank=0.9), GOOD)).doubt
    statuses = (Status("converged"),)
    assert mark_contradicted(statuses, (0,), (check,)) == statuses
    marked = mark_contradicted(statuses, (0,), (check,), {0: "noise hides the motion"})
    assert marked[0] == "contradicted" and "noise hides" in marked[0].message


def test_message_says_whether_the_picture_grows_or_shrinks():
    assert "grows by 1.0 %" in check_of(zoom=np.log1p(0.01)).message
    assert "shrinks by 1.0 %" in check_of(zoom=np.log1p(-0.01)).message


def observations_of(*frames):
    """Return the tracks of frames; each frame has a dictionary: track → (x, y)."""
    return [
        Observations(points=np.array(list(frame.values()), float), tracks=np.array(list(frame)))
        for frame in frames
    ]


def test_the_second_frame_of_a_pair_shares_many_tracks():
    # Near points leave the picture after two frames; far points remain, and hardly move.
    near = [{k: (3.0 * step + k, 0.0) for k in range(60)} for step in range(3)]
    far = [{100 + k: (0.3 * step + k, 50.0) for k in range(25)} for step in range(7)]
    frames = [(near[k] if k < 3 else {}) | in_frame for k, in_frame in enumerate(far)]
    assert choose_second_frame(0, range(7), observations_of(*frames), 300) == 2
    assert choose_second_frame(0, range(7), observations_of(*far), 90) == 6


def test_chained_flows_follow_the_pixels():
    # A shift by 2 px, then a flow that grows by 0.5 px from column to column.
    first = np.zeros((5, 20, 2), np.float32)
    first[..., 0] = 2
    second = np.zeros_like(first)
    second[..., 0] = 0.5 * np.arange(20)
    columns = np.arange(10)
    chained = chain_flows([first, second])[2, :10, 0]
    np.testing.assert_allclose(chained, 2 + 0.5 * (columns + 2), atol=1e-5)


def test_pixels_that_are_hidden_do_not_match():
    random = np.random.default_rng(0)
    first = cv2.GaussianBlur(random.uniform(0, 255, (60, 80)), (0, 0), 2).astype(np.float32)
    second = np.roll(first, 3, axis=1) * 0.8 + 20  # another light
    second[20:40, 30:50] = np.float32(random.uniform(0, 255, (20, 20)))
    flow = np.zeros((60, 80, 2), np.float32)
    flow[..., 0] = 3
    matches = find_matching_pixels(first, second, flow, np.ones((60, 80), bool))
    assert not matches[:, 77:].any()  # outside of the second frame
    assert matches[24:36, 31:43].mean() < 0.1  # hidden
    matches[:, 74:] = matches[14:44, 20:54] = True
    assert matches.mean() > 0.95


def test_checks_reuse_the_image_motion_of_the_tracks(monkeypatch):
    def refuse(*_):
        raise AssertionError("the motion is known from tracking")

    monkeypatch.setattr(dense_pairs, "find_flow", refuse)
    (check,) = reconstructed(film().frames).checks
    assert len(check.pairs) >= 2


@pytest.mark.parametrize(("turn", "contradicts"), [(0.0, False), (0.06, True)])
def test_pair_across_a_joint_is_checked_on_its_own(turn, contradicts):
    """All other pairs are right, so their medians would hide one wrong joint."""
    joint, poses = 6, dict(enumerate(film().poses))
    wrong = tisfm.rigid.pose_matrix([0, 0, 0, turn, 0, 0])
    for frame in range(joint, COUNT):
        poses[frame] = poses[joint - 1] @ wrong @ np.linalg.inv(poses[joint - 1]) @ poses[frame]
    random = np.random.default_rng(0)
    places = random.uniform((0, 0), (WIDTH, HEIGHT), (50, 2))
    tracks = {
        frame: Observations(
            points=places + 2.0 * frame, tracks=np.arange(50) + 100 * (frame >= joint)
        )
        for frame in poses
    }
    check = pieces.check_piece(
        poses, (), tracks, film().frames.__getitem__, lambda _: np.ones((HEIGHT, WIDTH), bool),
        lambda _: None, film().camera, views=(0, 5, 6, 9), joints=(joint,),
    )  # fmt: skip
    first, across = check.parts
    assert len(first.pairs) >= 2 and not first.contradicts
    assert [(pair.first, pair.second) for pair in across.pairs] == [(joint - 1, joint)]
    assert across.contradicts == check.contradicts == contradicts
    assert check.message.startswith("a part of the frames, 5 to 6") == contradicts
