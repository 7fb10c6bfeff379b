"""Moving objects of chunks: one id, one path and one size in the joined result."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tisfm
from tests.reconstruction.chunked.filmed import in_turn, write_frames
from tests.rendered import bodies_film
from tisfm.metrics import object_path_errors
from tisfm.reconstruction.chunks.entry import reconstruct_in_chunks
from tisfm.reconstruction.chunks.moving_objects import NO_AXES, join_ids, write_joined_objects
from tisfm.reconstruction.chunks.placement import ChunkPlacement, ChunkResult
from tisfm.reconstruction.result.folder import read_labels
from tisfm.reconstruction.result.moving_object import labelled_objects
from tisfm.rigid import pose_matrix
from tisfm.scenes import bodies_path

SIZE = 40, 60
COUNT = 10  # frames; the chunks have 0 to 5 and 4 to 9
SPANS = (range(6), range(4, 10))
EXTENT = np.array([4.0, 1.5, 2.0])  # of the first object, along its own axes


def labels_of(frame, ids):
    """Return labels of two squares that move, with an id each; 0 leaves one out."""
    labels = np.zeros(SIZE, np.uint8)
    labels[5:17, 3 + 2 * frame : 15 + 2 * frame] = ids[0]
    labels[22:34, 40 - 2 * frame : 52 - 2 * frame] = ids[1]
    return labels


def object_pose(frame):
    """Return the true pose of the first object, object to world."""
    return pose_matrix([0.3 * frame, 0.1, 5, 0, 0.1 * frame, 0])


def camera_pose(frame):
    return pose_matrix([0.05 * frame, 0, 0.02 * frame, 0, 0.01 * frame, 0])


def part_of(span, ids, *, scale=1.0, turn=(0, 0, 0), with_poses=True):
    """Return a chunk whose unit is 1/scale, and in which the first object has turned axes."""
    axes = np.eye(4)
    axes[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    labels = [labels_of(frame, ids) for frame in span]
    objects = labelled_objects(len(labels), lambda k: labels[k])
    if with_poses:
        poses = np.array([object_pose(frame) @ axes for frame in span])
        poses[:, :3, 3] /= scale
        extent = np.abs(axes[:3, :3].T @ EXTENT) / scale
        known = {"poses": poses, "extent": extent, "scale_from": "contact"}
        objects = [replace(obj, **known) if obj.id == ids[0] else obj for obj in objects]
    cameras = np.array([camera_pose(frame) for frame in span])
    cameras[:, :3, 3] /= scale
    result = SimpleNamespace(
        labels=lambda k: labels[k],
        objects=tuple(objects),
        poses=cameras,
        piece=np.zeros(len(span), int),
        has_position=np.ones(len(span), bool),
        largest_piece=0,
        shape=SIZE,
    )
    return ChunkResult(result=result, frames={frame: k for k, frame in enumerate(span)})


def placements(scales, split=5):
    """Return the placement of all frames; those from `split` on are in the second chunk."""
    return [
        ChunkPlacement(
            part=int(frame >= split),
            number=frame if frame < split else frame - SPANS[1].start,
            piece=0,
            pose=camera_pose(frame),
            scale=scales[int(frame >= split)],
        )
        for frame in range(COUNT)
    ]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ((1, 2), (2, 1), [{1: 1, 2: 2}, {2: 1, 1: 2}]),
        ((1, 0), (4, 3), [{1: 1}, {3: 2, 4: 1}]),  # the second one appears later
        ((2, 5), (0, 1), [{2: 1, 5: 2}, {1: 2}]),
    ],
)
def test_an_object_keeps_its_id(first, second, expected):
    assert join_ids([part_of(SPANS[0], first), part_of(SPANS[1], second)]) == expected


def test_other_places_are_other_objects():
    before = part_of(SPANS[0], (1, 0))
    after = part_of(SPANS[1], (0, 1))
    assert join_ids([before, after]) == [{1: 1}, {1: 2}]


def test_ids_beyond_the_values_of_a_label_are_left_out():
    many = SimpleNamespace(
        labels=lambda k: np.zeros(SIZE, np.uint8),
        objects=tuple(SimpleNamespace(id=k) for k in range(1, 201)),
    )
    parts = [ChunkResult(result=many, frames={k: 0}) for k in range(2)]
    ids = join_ids(parts)
    assert max(ids[1].values()) == 254 and len(ids[0]) == 200 and len(ids[1]) == 54


def test_labels_and_poses_are_joined(tmp_path):
    parts = [
        part_of(SPANS[0], (1, 2), scale=2.0),
        part_of(SPANS[1], (2, 1), scale=5.0, turn=(0.3, -0.2, 0.5)),
    ]
    objects = write_joined_objects(tmp_path, parts, placements((2.0, 5.0)))
    for frame in range(COUNT):
        found = read_labels(tmp_path, frame, SIZE)
        np.testing.assert_array_equal(found, labels_of(frame, (1, 2)))
    assert [obj.id for obj in objects] == [1, 2]
    assert objects[0].frames == tuple(range(COUNT)) and objects[0].scale_from == "contact"
    np.testing.assert_allclose(
        objects[0].poses, [object_pose(frame) for frame in range(COUNT)], atol=1e-9
    )
    np.testing.assert_allclose(objects[0].extent, EXTENT)
    assert not np.isfinite(objects[1].poses).any() and objects[1].scale_from == "none"


def test_axes_without_a_shared_frame_are_unknown(tmp_path):
    parts = [part_of(SPANS[0], (1, 2)), part_of(SPANS[1], (1, 2))]
    for part, hidden in zip(parts, (slice(4, 6), slice(0, 2)), strict=True):
        part.result.objects[0].poses[hidden] = np.nan
    (known, _) = write_joined_objects(tmp_path, parts, placements((1.0, 1.0)))
    assert np.isfinite(known.poses[:4]).all() and not np.isfinite(known.poses[4:]).any()
    assert known.message == NO_AXES


def test_axes_and_extent_are_those_of_the_chunk_with_most_poses(tmp_path):
    turn = (0, np.pi / 2, 0)
    parts = [part_of(SPANS[0], (1, 2)), part_of(SPANS[1], (1, 2), turn=turn)]
    parts[0].result.objects[0].poses[:4] = np.nan
    (known, _) = write_joined_objects(tmp_path, parts, placements((1.0, 1.0)))
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    expected = [object_pose(frame) @ turned for frame in range(4, COUNT)]
    np.testing.assert_allclose(known.poses[4:], expected, atol=1e-9)
    assert not np.isfinite(known.poses[:4]).any() and known.message == ""
    np.testing.assert_allclose(known.extent, EXTENT[[2, 1, 0]], atol=1e-9)


def test_poses_are_in_the_largest_piece(tmp_path):
    """The chunks lie in two pieces, whose units have an unknown ratio."""
    parts = [part_of(SPANS[0], (1, 2)), part_of(SPANS[1], (1, 2), scale=3.0)]
    placed = [
        replace(placement, piece=placement.part) for placement in placements((1.0, 1.0), split=6)
    ]
    (known, _) = write_joined_objects(tmp_path, parts, placed)
    np.testing.assert_allclose(known.poses[:6], [object_pose(frame) for frame in range(6)])
    assert not np.isfinite(known.poses[6:]).any()


def test_a_larger_piece_without_positions_does_not_count(tmp_path):
    parts = [part_of(SPANS[0], (1, 2)), part_of(SPANS[1], (1, 2))]
    parts[0].result.has_position[:] = False
    placed = [
        replace(placement, piece=placement.part) for placement in placements((1.0, 1.0), split=6)
    ]
    (known, _) = write_joined_objects(tmp_path, parts, placed)
    assert not np.isfinite(known.poses[:6]).any()
    np.testing.assert_allclose(known.poses[6:], [object_pose(frame) for frame in range(6, COUNT)])


@pytest.mark.nightly
def test_a_body_has_one_path_through_all_chunks(tmp_path):
    film = bodies_film(bodies_path(40), 240, 320)
    found = reconstruct_in_chunks(
        write_frames(tmp_path / "film", film.frames),
        tmp_path / "out",
        map_unordered=in_turn,
        chunk=26,
        camera=film.camera,
        settings=tisfm.Settings.preset("fast", motion="objects"),
    )
    again = tisfm.Reconstruction.load(found.folder)
    assert [obj.frames for obj in again.objects] == [obj.frames for obj in found.objects]
    scores = tisfm.metrics.label_scores([found.labels(k) for k in range(40)], film.labels)
    assert scores.switches == 0
    errors = []
    for item in scores.objects:
        body = next((obj for obj in found.objects if obj.id == item.label), None)
        if body is None or np.isfinite(body.poses[:, 0, 0]).sum() <= 26:  # of one chunk
            continue
        poses = np.full((40, 4, 4), np.nan)
        poses[list(body.frames)] = body.poses
        truth = film.body_poses[item.object_id - 1]
        errors.append(object_path_errors(poses, truth, found.poses, film.poses))
    assert errors
    assert all(error.share < 0.1 and error.rotation < 10 for error in errors)
