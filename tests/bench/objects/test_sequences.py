"""Benchmark of moving things over sequences: peers, tracking and scores. No timing."""

import json
import os
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import tisfm
from bench.objects import segmentation, sequences
from bench.objects.clips import (
    RENDERED_CLIPS,
    davis_clip,
    davis_folders,
    neighbours,
    render_clip,
)
from bench.objects.mask_scores import boundary_f, object_depth_score, union_iou
from bench.objects.segmentation import one_label, track_parts
from bench.objects.sequence_methods import ClipLabels, Reconstruct
from bench.objects.sequence_scores import ClipScore, best, details, every_clip, score_clip, table
from bench.shared.contest import MethodFailure
from tests.noise import moving_noise
from tisfm.formats import write_png

THREADS = str(os.cpu_count())  # as the tests started Taichi


@pytest.fixture(scope="module")
def clip():
    return render_clip("bodies", small=True)


def panned(count=5, size=(120, 180)):
    """Frames of a plane that a camera pans over, and of a square that moves on it."""
    height, width = size
    wide = np.clip(moving_noise(height + 20, width + 60, (0, 0))[0], 0, 255).astype(np.uint8)
    frames, masks = [], []
    for k in range(count):
        frame = wide[4:, 3 * k :][:height, :width].copy()
        mask = np.zeros(size, np.uint8)
        mask[40:80, 40 + 12 * k : 84 + 12 * k] = 1
        frame[mask > 0] = 255
        frames.append(frame)
        masks.append(mask)
    return frames, masks


def overlap(one, other):
    return ((one > 0) & (other > 0)).sum() / ((one > 0) | (other > 0)).sum()


def test_homographies_are_those_of_the_background():
    frames, _ = panned()
    steps = segmentation.homographies(frames)
    assert len(steps) == 4
    corners = np.array([[[20.0, 20], [160, 20], [160, 100]]])
    for matrix, shift in ((segmentation.homography_between(steps, 0, 4), -12), (steps[1], -3)):
        moved = cv2.perspectiveTransform(corners, matrix)
        np.testing.assert_allclose(moved - corners, np.full((1, 3, 2), (shift, 0)), atol=1)
    back = segmentation.homography_between(steps, 4, 0) @ segmentation.homography_between(
        steps, 0, 4
    )
    np.testing.assert_allclose(back, np.eye(3), atol=1e-9)


def test_flow_unlike_the_background_is_a_moving_object():
    frames, masks = panned(7)
    steps = segmentation.homographies(frames)
    # In 3 frames it moves by more than its width.
    for both, least in ((True, 0.7), (False, 0.3)):
        off = segmentation.differences(frames, steps, 3, both=both)
        assert overlap(segmentation.clean_mask(off[3] > 25), masks[3]) > least
        before = (masks[0] > 0) & (masks[3] == 0)
        shown = np.roll(before, -9, axis=1)  # where it was, in the axes of frame 3
        assert (np.median(off[3][shown]) < 10) == both
    (alone,) = segmentation.differences(frames[:1], [], 1, both=True)
    assert not alone.any()
    mixture = segmentation.mixtures(frames, steps, 3, 16.0)[3]
    assert mixture[masks[3] > 0].mean() > 4 * mixture[masks[3] == 0].mean()
    assert list(neighbours(10, 1, 1, 4)) == [4, 3, 0, 2]


def test_flow_without_the_background_motion():
    flow = np.zeros((60, 80, 2), np.float32)
    flow[..., 0] = 2 + 0.01 * np.arange(80)
    flow[20:40, 30:50] += (3, -1)
    left, length = segmentation.homography_residual(flow)
    np.testing.assert_allclose(left[30, 40], (3, -1), atol=0.05)
    assert length[5, 5] < 0.05 and length[30, 40] == pytest.approx(np.sqrt(10), abs=0.05)
    _, off = segmentation.epipolar_distance(flow)
    assert off[5, 5] < 0.1 < 0.3 < off[30, 40]


def test_clusters_are_of_one_motion():
    moving = np.zeros((40, 60), bool)
    moving[10:30, 5:25] = moving[10:30, 30:50] = True
    left = np.zeros((40, 60, 2), np.float32)
    left[:, :28, 0], left[:, 28:, 0] = 4, -4
    labels = segmentation.clusters(left, moving, 2)
    assert ((labels > 0) == moving).all()
    assert len(np.unique(labels[10:30, 5:25])) == len(np.unique(labels[10:30, 30:50])) == 1
    assert len(np.unique(labels)) == 3
    assert (segmentation.clusters(left, moving, 1) == moving).all()
    assert not segmentation.clusters(left, np.zeros_like(moving), 3).any()


def test_parts_keep_their_label_where_they_overlap():
    masks = np.zeros((4, 30, 40), np.uint8)
    for k in range(4):
        masks[k, 5:15, 3 * k : 3 * k + 10] = 1
        if k != 1:  # lost for a while
            masks[k, 20:28, 20:30] = 2
    masks[2, 0, 39] = 1  # too small
    labels = track_parts(masks)
    assert [sorted(np.unique(label)) for label in labels] == [
        [0, 1, 2],
        [0, 1],
        [0, 1, 2],
        [0, 1, 2],
    ]
    assert all((label == 1).sum() == 100 for label in labels)
    assert all(
        (one > 0).sum() == (mask > 0).sum()
        for one, mask in zip(one_label(masks), masks, strict=True)
    )
    masks[3] = np.roll(masks[3], 20, axis=1)  # both elsewhere
    assert set(np.unique(track_parts(masks)[3])) - {0} != {1, 2}


def test_clips_of_davis_are_read(tmp_path):
    frames, masks = panned(3)
    for name, pictures in (("images", frames), ("masks", [255 * mask for mask in masks])):
        folder = tmp_path / "davis" / "square" / name
        folder.mkdir(parents=True)
        for k, picture in enumerate(pictures):
            write_png(folder / f"{k:05d}.png", picture)
    (folder,) = davis_folders(tmp_path)
    clip = davis_clip(folder)
    assert (clip.name, clip.group, len(clip.frames)) == ("square", "DAVIS", 3)
    np.testing.assert_array_equal(clip.truth[2], 255 * masks[2])
    assert davis_folders(tmp_path / "davis") == []
    (folder / "masks" / "00002.png").unlink()
    with pytest.raises(ValueError, match="3 images and 2 masks"):
        davis_clip(folder)


def test_scores_are_those_of_the_metrics(clip):
    perfect = score_clip("a", clip, ClipLabels(variant="x", labels=clip.truth, seconds=12.0))
    assert perfect.iou == 1 and perfect.followed == 1 and perfect.switches == 0
    assert perfect.seconds == 2 and perfect.paths == ()
    items = tuple(
        SimpleNamespace(id=k + 1, frames=(0, 1, 2, 4), poses=clip.body_poses[k, [0, 1, 2, 4]])
        for k in (0, 1)
    )
    found = ClipLabels(
        variant="", labels=clip.truth, seconds=1.0, objects=items, cameras=clip.film.poses
    )
    paths = score_clip("b", clip, found).paths
    assert paths[2] is None and [error.frames for error in paths[:2]] == [4, 4]
    assert paths[0].share < 1e-6
    rows = table([perfect, score_clip("b", clip, found)]).rows
    assert rows[0] == ["a (x)", "1.000", "1.000", "1.000", "100", "0", "–", "2.00", "–", "–"]
    assert rows[1][-2:] == ["0.0 (1 not found)", "0.0"]


def test_peers_are_compared_at_their_best():
    given = {"method": "a", "group": "DAVIS"}
    scores = [
        ClipScore(**given, clip="one", variant="x", iou=0.9),
        ClipScore(**given, clip="two", variant="x", iou=0.1),
        ClipScore(**given, clip="one", variant="y", iou=0.6, switches=2),
        ClipScore(**given, clip="two", variant="y", iou=0.6, switches=1),
    ]
    assert best(scores) == scores[2:]
    (row,) = table(scores).rows
    assert row[:4] == ["a (y)", "0.600", "0.600", "0.600"] and row[7] == "3"
    assert details(scores).rows == [["a", "x", "0.500", "0"], ["a", "y", "0.600", "3"]]
    assert [row[:3] for row in every_clip(scores).rows] == [
        ["one", "a", "0.600"],
        ["two", "a", "0.600"],
    ]
    failed = ClipScore(method="b", group="DAVIS", clip="one", variant="", failure="no")
    assert table([*scores, failed]).rows[1] == ["b", *["–"] * 9]


def test_a_result_with_labels_is_read(clip, monkeypatch):
    asked = []

    def reconstruct(frames, **options):
        asked.append(options)
        return SimpleNamespace(
            labels=lambda k: clip.truth[k],
            depth=lambda k: 2 * clip.film.depth[k],
            inverse_depth_std=lambda k: np.where(clip.truth[k] == 1, np.inf, 0.01),
            objects=(),
            poses=clip.film.poses,
        )

    monkeypatch.setattr(tisfm, "reconstruct", reconstruct)
    (found,) = Reconstruct("fast").run(clip)
    assert asked[0]["settings"].motion == "objects" and asked[0]["camera"] == clip.camera
    score = score_clip("tisfm", replace(clip, body_poses=None), found)
    assert score.iou == score.union == score.boundary == 1
    assert score.depth == pytest.approx(0, abs=1e-6)
    frames = [set(np.unique(mask)) - {0} for mask in clip.truth]
    known = sum(len(numbers - {1}) for numbers in frames)
    assert score.with_depth == pytest.approx(known / sum(map(len, frames)))
    monkeypatch.setattr(tisfm, "reconstruct", lambda frames, **_: SimpleNamespace())
    with pytest.raises(MethodFailure, match="no labels"):
        next(Reconstruct("fast").run(clip))


def test_union_and_boundary_of_masks():
    truth = np.zeros((100, 100), np.uint8)
    truth[20:60, 20:60] = 1
    shifted = np.roll(truth, 1, axis=1)
    assert union_iou([truth, 3 * truth], [truth, truth]) == boundary_f([truth], [truth]) == 1
    assert union_iou([shifted], [truth]) == pytest.approx(39 / 41)
    assert boundary_f([shifted], [truth]) == 1  # within 2 px
    assert boundary_f([np.roll(truth, 10, axis=1)], [truth]) < 0.7
    none = np.zeros_like(truth)
    assert union_iou([none], [truth]) == boundary_f([none], [truth]) == 0
    assert union_iou([none], [none]) == boundary_f([none], [none]) == 1


@pytest.mark.parametrize(("post", "order"), [(1.0, 1.0), (9.0, 0.0)])
def test_depth_of_objects_is_compared_in_the_scale_of_the_scene(post, order):
    labels = np.zeros((60, 80), np.uint8)
    labels[20:50, 30:42] = 1
    depth = np.where(labels == 1, 4.0, 8.0)
    depth[:, 42:50] = 2.0  # a post in front of the object
    found = np.where(labels == 1, 1.1 * depth, depth)
    found[:, 42:50] = post
    score = object_depth_score([found / 3], [labels], depth[None], [labels])
    assert score.error == pytest.approx(0.1) and score.order == order


@pytest.mark.nightly
def test_smoke(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sequences, "RESULTS", tmp_path)
    options = ["--smoke", "--threads", THREADS, "--only", "homography", "DIS"]
    assert sequences.main(options) == 0
    assert "OpenCV DIS medium + clusters" in capsys.readouterr().out
    text = (tmp_path / "smoke-objects_sequences.md").read_text(encoding="utf-8")
    assert "missing: DAVIS" in text and "## Rendered films" in text and "MOG2" in text
    record = json.loads((tmp_path / "smoke-objects_sequences.json").read_text(encoding="utf-8"))
    assert {score["clip"] for score in record["scores"]} == set(RENDERED_CLIPS)
    assert sequences.main(["--smoke", "--only", "nothing", "--threads", THREADS]) == 2
