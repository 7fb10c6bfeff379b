"""Sequences of rigid motions: their poses, and a focal length that is guessed."""

import gc
from dataclasses import replace
from itertools import repeat

import numpy as np
import pytest
from PIL import ExifTags, Image

import tisfm
from tests.sources.made import FRAMES, Counted, H, W
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.rigid import pose_matrix
from tisfm.running.pairs import attach_poses
from tisfm.sources import FramePair, FrameSource

CAMERA_MOTION = tisfm.Settings(motion="camera", warps=1, outer_iterations=1, sweeps=2)
TURNS = [pose_matrix((0, 0, 0, 0, 0.001 * k, 0)) for k in range(5)]


@pytest.fixture
def asked(monkeypatch):
    """The cameras and poses that interpretations are asked for, without the work."""
    from tisfm import pair

    seen = []
    original = pair.interpret

    def interpret(frame0, frame1, *, camera, settings, pose, fixed_pixels):
        seen.append((camera, pose))
        plain = replace(settings, motion="field")
        camera = camera or tisfm.Camera(1.2 * max(frame0.shape))
        return original(frame0, frame1, camera=camera, settings=plain)

    monkeypatch.setattr(pair, "interpret", interpret)
    return seen


def gradually(items):
    yield from items


@pytest.mark.parametrize("kind", [list, tuple, np.stack, gradually])
@pytest.mark.parametrize("source", [list, gradually])
def test_every_pair_has_its_pose(asked, kind, source):
    camera = tisfm.Camera(50.0)
    poses, frames = kind(TURNS[:4]), source(FRAMES[:5])
    results = tisfm.interpret_sequence(frames, camera=camera, settings=CAMERA_MOTION, poses=poses)
    assert len(list(results)) == 4
    for (given_camera, pose), expected in zip(asked, TURNS, strict=False):
        assert given_camera is camera
        np.testing.assert_array_equal(pose, expected)


def test_a_pose_changes_the_result():
    camera, settings = tisfm.Camera(50.0), CAMERA_MOTION
    poses = [pose_matrix((0.1 * k, 0, 0.1, 0, 0.001, 0)) for k in (1, 2)]
    results = tisfm.interpret_sequence(FRAMES[:3], camera=camera, settings=settings, poses=poses)
    for k, result in enumerate(results):
        expected = tisfm.interpret(
            FRAMES[k], FRAMES[k + 1], camera=camera, settings=settings, pose=poses[k]
        )
        np.testing.assert_array_equal(result.inverse_depth, expected.inverse_depth)
        np.testing.assert_allclose(pose_matrix(result.motions[0])[:3, :3], poses[k][:3, :3])


def test_poses_need_not_end(asked):
    results = tisfm.interpret_sequence(
        FRAMES[:4], camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=repeat(np.eye(3))
    )
    assert len(list(results)) == len(asked) == 3


@pytest.mark.parametrize("number", [0, 1, 3, 5])
def test_another_number_of_poses_is_reported_at_once(number):
    with pytest.raises(ValueError, match=rf"poses are {number}, but there are 2 pairs of frames"):
        tisfm.interpret_sequence(FRAMES[:3], settings=CAMERA_MOTION, poses=TURNS[:1] * number)


def test_poses_are_counted_by_steps(asked):
    options = {"camera": tisfm.Camera(), "settings": CAMERA_MOTION, "step": 2}
    assert len(list(tisfm.interpret_sequence(FRAMES[:5], poses=TURNS[:2], **options))) == 2
    with pytest.raises(ValueError, match="poses are 4, but there are 2 pairs"):
        tisfm.interpret_sequence(FRAMES[:5], poses=TURNS[:4], **options)
    with pytest.raises(ValueError, match="but there is 1 pair of frames"):
        tisfm.interpret_sequence(FRAMES[:2], settings=CAMERA_MOTION, poses=TURNS[:2])


@pytest.mark.parametrize("source", [list, gradually])
def test_poses_that_end_early_are_reported_at_their_end(asked, source):
    results = tisfm.interpret_sequence(
        source(FRAMES[:4]),
        camera=tisfm.Camera(),
        settings=CAMERA_MOTION,
        poses=gradually(TURNS[:2]),
    )
    assert [next(results).status for _ in range(2)]
    with pytest.raises(
        ValueError, match="poses ended before frames frame_000002 and frame_000003, after 2"
    ):
        next(results)


def test_remaining_poses_are_reported_at_the_end(asked):
    results = tisfm.interpret_sequence(
        gradually(FRAMES[:3]), camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=TURNS[:4]
    )
    assert [next(results).status for _ in range(2)]
    with pytest.raises(ValueError, match="poses are 4, but there are 2 pairs of frames"):
        next(results)


def test_a_video_may_announce_too_many_frames(video, asked):
    """What it announces is not compared with the number of poses; what it holds is."""
    path, frames = video
    source = FrameSource(path)
    assert source.count is None and len(source) == 5
    source._reader.stated_count += 2
    pairs = list(attach_poses(source, TURNS[: len(frames) - 1]))
    assert len(pairs) == 5 and all(pair.pose is not None for pair in pairs)


@pytest.mark.parametrize(
    ("poses", "error", "words"),
    [
        (np.eye(4), ValueError, r"poses is \(4, 4\): expected one for every pair"),
        (3, TypeError, "poses is 3: expected a 4×4 or 3×3 array for every pair"),
    ],
)
def test_other_values_than_poses_are_refused(poses, error, words):
    with pytest.raises(error, match=words):
        tisfm.interpret_sequence(FRAMES[:2], settings=CAMERA_MOTION, poses=poses)


def test_a_wrong_pose_names_its_frames():
    results = tisfm.interpret_sequence(
        FRAMES[:3], camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=[np.eye(3), np.eye(2)]
    )
    next(results)
    with pytest.raises(ValueError, match="frames frame_000001 and frame_000002: pose has the sha"):
        next(results)


@pytest.mark.parametrize("motion", ["field", "objects"])
def test_poses_are_for_rigid_motions(motion):
    with pytest.raises(ValueError, match=f'poses are given, but motion="{motion}"'):
        tisfm.interpret_sequence(
            FRAMES[:3], settings=tisfm.Settings(motion=motion), poses=TURNS[:2]
        )


def test_the_pose_is_part_of_the_identity_of_a_pair():
    plain, turned, other = (
        FramePair(name0="a", name1="b", frame0=FRAMES[0], frame1=FRAMES[1], pose=pose)
        for pose in (None, TURNS[1], TURNS[2])
    )
    again = replace(plain, pose=TURNS[1].tolist())
    assert len({plain.digest, turned.digest, other.digest}) == 3
    assert again.digest == turned.digest


def test_two_frames_are_alive_at_a_time_with_poses(asked):
    frames = Counted(12)
    gc.disable()
    try:
        for _ in tisfm.interpret_sequence(
            frames, camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=repeat(np.eye(3))
        ):
            pass
    finally:
        gc.enable()
    assert frames.most == 2 and frames.alive == 0


@pytest.mark.parametrize("source", [list, gradually])
def test_the_focal_length_is_guessed_once(source):
    with pytest.warns(GuessedFocalWarning) as caught:
        results = list(tisfm.interpret_sequence(source(FRAMES[:4]), settings=CAMERA_MOTION))
    assert len(caught) == 1 and "48 px" in str(caught[0].message)
    assert {result.camera for result in results} == {tisfm.Camera(1.2 * W)}


def test_the_focal_length_is_guessed_from_the_first_file(folder, recwarn):
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: 50}
    Image.fromarray(FRAMES[0]).save(folder / "frame1.png", exif=exif.tobytes())
    results = list(tisfm.interpret_sequence(folder, settings=CAMERA_MOTION))
    guesses = [w for w in recwarn if w.category is GuessedFocalWarning]
    assert len(results) == 4 and len(guesses) == 1 and "50 mm" in str(guesses[0].message)
    focal = 50 * np.hypot(H, W) / np.hypot(24, 36)
    assert [result.camera.focal for result in results] == pytest.approx([focal] * 4)


@pytest.mark.parametrize(
    ("camera", "motion"), [(tisfm.Camera(50.0), "camera"), (None, "field")], ids=["given", "field"]
)
def test_guesses_are_made_only_where_needed(folder, recwarn, camera, motion):
    settings = replace(CAMERA_MOTION, motion=motion)
    results = list(tisfm.interpret_sequence(folder, camera=camera, settings=settings))
    assert {result.camera for result in results} == {camera or tisfm.Camera()}
    assert not [w for w in recwarn if w.category is GuessedFocalWarning]
