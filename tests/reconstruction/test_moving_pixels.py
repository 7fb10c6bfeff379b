"""Pixels that move on their own are masked where they contradict the path of a static scene."""

from functools import cache

import numpy as np
import pytest

import tisfm
from tests.exports.made import made
from tests.reconstruction.films import path_error
from tisfm.exports import SequenceFrames
from tisfm.grade import Grade
from tisfm.reconstruction.result.folder import write_labels
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.result.statuses import (
    NEW_PIECE_NOTE,
    ONLY_TURNS,
    add_mask_notes,
    add_piece_note,
    find_cause,
    mark_contradicted,
    mark_uncertain,
)
from tisfm.reconstruction.stages.moving_pixels import may_show_objects
from tisfm.report.reconstruction_report import _report
from tisfm.rigid import pose_matrix
from tisfm.scenes import Box, Plane, Scene, Texture
from tisfm.status import Status

HEIGHT, WIDTH, COUNT = 96, 200, 8
CAMERA = tisfm.Camera(focal=160.0)
FAST = tisfm.Settings.preset("fast", motion="camera")
LORRY = 4  # index of the object
STEP = 0.5  # m a frame, the camera's


def paint(seed, wavelength, mean=128.0):
    return Texture(wavelength=wavelength, detail=3, mean=mean, contrast=90, seed=seed)


def street(number, speed):
    """Return a street; a lorry beside the camera drives by a speed, m a frame."""
    objects = [
        Plane(texture=paint(1, 0.5), point=(0, 1.6, 0), normal=(0, -1, 0)),
        Plane(texture=paint(2, 1.5), point=(-8, 0, 0), normal=(1, 0, 0)),
        Plane(texture=paint(3, 1.5), point=(8, 0, 0), normal=(-1, 0, 0)),
        Plane(texture=paint(4, 12.0), point=(0, 0, 60), normal=(0, 0, -1)),
        Box(texture=paint(5, 0.4, 90), center=(3.2, -0.2, 9 + speed * number), size=(2.4, 3.4, 9)),
        Box(texture=paint(6, 0.4, 90), center=(-3.5, 0.9, 14), size=(1.8, 1.4, 4)),
    ]
    return Scene(objects=objects, camera=CAMERA, height=HEIGHT, width=WIDTH)


@cache
def drive():
    """Return frames, depth and labels, (N, H, W) each, and poses; the lorry overtakes."""
    poses = [pose_matrix([0, 0, STEP * k, 0, 0.004 * k, 0]) for k in range(COUNT)]
    views = [
        street(k, 0.8).render_view_with_labels(pose, samples=1) for k, pose in enumerate(poses)
    ]
    frames, depth, labels = map(np.stack, zip(*views, strict=True))
    return np.rint(frames).clip(0, 255).astype(np.uint8), depth, labels, np.stack(poses)


# Without the mask, the path is contradicted: the lorry would lie behind the camera.
def test_lorry_that_drives_along_is_masked(tmp_path):
    frames, true_depth, labels, poses = drive()
    reports = []
    result = tisfm.reconstruct(
        frames,
        camera=CAMERA,
        settings=FAST,
        depth_of="keyframes",
        folder=tmp_path,
        progress=lambda *report: reports.append(report),
    )
    assert reports.count(("path", 0, len(frames))) == 2  # the search begins the stage again
    assert set(result.status) <= {"converged", "uncertain"} and not result.objects
    assert "converged" in result.status
    loaded = tisfm.Reconstruction.load(tmp_path)
    for number, status in enumerate(result.status):  # beside a large lorry, depth is doubtful
        share = (loaded.labels(number) > 0).mean()
        assert (status == "uncertain") == (share > 0.35 and np.isfinite(result.depth_error[number]))
    assert path_error(result.poses, poses) < 0.01
    masks = SequenceFrames(loaded).masks(0)
    np.testing.assert_array_equal(masks.pop("at-rest"), loaded.labels(0) == 0)
    assert not masks
    for frame in result.keyframes:
        masked, lorry = loaded.labels(frame) > 0, labels[frame] == LORRY
        assert masked[lorry].mean() > 0.95 and masked[~lorry].mean() < 0.06
        assert f"{100 * masked.mean():.0f} % of the frame" in result.status[frame].message
        assert result.grade(frame) == (
            Grade.FAIR if result.status[frame] == "converged" else Grade.POOR
        )
        assert np.isinf(result.inverse_depth_std(frame)[masked]).all()
        ratio = (result.depth(frame) / true_depth[frame])[~masked]
        assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.08  # measured: 0.065


def test_masked_pixels_are_shown_and_have_no_motion_of_the_scene(tmp_path):
    result = made(tmp_path, count=2)
    assert "object" not in SequenceFrames(result).quantities
    with pytest.raises(ValueError, match="no masked pixels that move"):
        SequenceFrames(result).masks(0)
    labels = np.zeros(result.shape, np.uint8)
    labels[10:20, 20:30] = 1
    write_labels(tmp_path, 0, labels)
    write_labels(tmp_path, 1, 0 * labels)
    frames = SequenceFrames(result)
    frame, other = frames.read(0), frames.read(1)
    assert "object" in frames.quantities and not other.labels.any()
    np.testing.assert_array_equal(frame.labels, labels)
    assert np.isnan(frame.flow[labels > 0]).all() and np.isfinite(frame.flow[20:]).any()
    titles = {picture.title for picture in _report(result, tmp_path, None).slides[0].pictures}
    assert "Pixels that move and are masked" in titles


def contradicted_by(*names):
    """Return a check with these objections."""

    class Check(PathCheck):
        objections = names
        contradicts = True

    return Check(pairs=(), fixed_share=0.0, infinity_motion=0.0)


@pytest.mark.parametrize(
    ("objections", "expected"),
    [
        (("residual", "behind"), True),
        (("excess", "residual", "rank", "behind"), True),
        (("residual", "direction"), False),
        (("behind", "zoom"), False),
        (("fixed",), False),
    ],
)
def test_only_a_path_with_the_right_direction_may_show_objects(objections, expected):
    assert may_show_objects([contradicted_by(*objections)]) == expected


def test_one_piece_of_another_cause_shows_no_objects():
    checks = [contradicted_by("residual", "behind"), contradicted_by("zoom")]
    assert not may_show_objects(checks)
    assert not may_show_objects([])
    good = PathCheck(pairs=(), fixed_share=0.0, infinity_motion=0.0)
    assert not may_show_objects([good]) and may_show_objects([good, checks[0]])


def test_status_says_how_much_of_a_frame_is_masked():
    statuses = [
        Status("converged"), Status("converged", "a note"), Status("little_parallax", "x"),
        Status("no_pose", "few tracks"), ONLY_TURNS,
    ]  # fmt: skip
    shares = np.array([0.0, 0.25, 0.5, 0.5, 0.5])
    noted = add_mask_notes(statuses, [0, 0, 0, -1, 1], shares, np.zeros(5, bool))
    assert noted[0].message == "" and noted[3].message == "few tracks"
    assert noted[1].message.startswith("25 % of the frame moves on its own and is masked")
    assert noted[1].message.endswith("; a note") and noted[2].message.endswith("; x")
    assert "is masked; the camera only turns" in noted[4].message and noted[4] == "pure_rotation"


def test_later_marks_keep_the_note_on_masked_pixels():
    first = add_piece_note(Status("converged"))
    (noted,) = add_mask_notes([first], [0], np.array([0.3]), np.array([False]))
    (rough,) = mark_uncertain([noted], np.array([0.4]))
    (wrong,) = mark_contradicted([rough], [0], [contradicted_by("residual", "behind")], {0: "fog"})
    for status, code in ((rough, "uncertain"), (wrong, "contradicted")):
        assert status == code and status.message.count("is masked") == 1
        assert status.message.startswith("30 % of the frame moves on its own and is masked: choose")
        assert status.message.endswith(NEW_PIECE_NOTE)
    assert find_cause(wrong) == "fog"


@pytest.mark.parametrize(("share", "has_depth"), [(0.4, True), (0.4, False), (0.2, True)])
def test_depth_beside_much_that_moves_is_uncertain(share, has_depth):
    status = Status("converged")
    (noted,) = add_mask_notes([status], [0], np.array([share]), np.array([has_depth]))
    is_doubtful = share > 0.35 and has_depth
    assert noted == ("uncertain" if is_doubtful else "converged")
    assert ("the depth of the rest is uncertain" in noted.message) == is_doubtful
