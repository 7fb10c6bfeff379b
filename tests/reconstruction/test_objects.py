"""Moving objects in a sequence."""

import itertools
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import path_error
from tests.rendered import bodies_film
from tisfm.formats import FormatError
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS, FlowPair, ImageMotion
from tisfm.reconstruction.objects.identities import ObjectTracker
from tisfm.reconstruction.objects.motion_evidence import Evidence, accumulate_evidence
from tisfm.reconstruction.objects.moving_regions import SmoothMotions
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels, enlarge_labels
from tisfm.reconstruction.objects.tracked_objects import (
    TrackedObject,
    final_labels,
    mask_position,
    most_similar_object,
)
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.scenes import bodies_path

OBJECTS = tisfm.Settings.preset("fast", motion="objects")
DATA = Path(__file__).parents[3] / "shared" / "data"


def film(bodies=3, count=10):
    """Return a film with moving bodies."""
    return bodies_film(bodies_path(count), 120, 160, bodies=bodies)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Return the reconstruction of the film."""
    return tisfm.reconstruct(
        list(film().frames),
        camera=film().camera,
        settings=OBJECTS,
        depth_of="keyframes",
        folder=tmp_path_factory.mktemp("objects") / "result",
    )


def iou(labels, true):
    """Return the intersection over union of two masks."""
    return (labels & true).sum() / max(1, (labels | true).sum())


def test_objects_keep_their_labels(found):
    labels = np.stack([found.labels(k) for k in range(len(found))])
    ids = []
    for body in (1, 3):
        true = film().labels == body
        scores = {
            t.id: np.mean([iou(a == t.id, b) for a, b in zip(labels, true, strict=True)])
            for t in found.objects
        }
        best = max(scores, key=scores.get)
        assert scores[best] > 0.85
        ids.append(best)
    assert len(set(ids)) == 2
    at_rest = [iou(a == 0, b == 0) for a, b in zip(labels, film().labels, strict=True)]
    assert np.mean(at_rest) > 0.95


def test_path_ignores_moving_objects(found):
    # Measured: 0.0048, and 0.0025 without objects.
    assert path_error(found.poses, film().poses) < 0.008


def test_static_scene_has_no_objects():
    still = film(bodies=0, count=6)
    result = tisfm.reconstruct(
        list(still.frames), camera=still.camera, depth_of="none", settings=OBJECTS
    )
    assert result.objects == ()
    assert not any(result.labels(k).any() for k in range(len(result)))


def test_depth_of_the_room_is_not_disturbed(found):
    for frame in found.keyframes:
        depth, sure = found.depth(frame), np.isfinite(found.inverse_depth_std(frame))
        at_rest = (film().labels[frame] == 0) & (found.labels(frame) == 0) & sure
        true = film().depth[frame]
        scale = np.median(true[at_rest] / depth[at_rest])
        assert np.abs(scale * depth / true - 1)[at_rest].mean() < 0.03


def test_boxes_and_files_agree_with_labels(found):
    about = json.loads((found.folder / "objects.json").read_text())
    assert [thing["id"] for thing in about["objects"]] == [t.id for t in found.objects]
    for thing in found.objects:
        for frame, box in zip(thing.frames, thing.boxes, strict=True):
            mask = np.uint8(found.labels(frame) == thing.id)
            assert tuple(box) == cv2.boundingRect(mask)
        assert thing.poses.shape == (len(thing.frames), 4, 4)
    others = set(range(len(found)))
    for thing in found.objects:
        for frame in others - set(thing.frames):
            assert not (found.labels(frame) == thing.id).any()


def test_loaded_result_equals_the_saved_one(found, tmp_path):
    found.save(tmp_path / "copy")
    again = tisfm.Reconstruction.load(tmp_path / "copy")
    np.testing.assert_array_equal(again.labels(3), found.labels(3))
    for one, two in zip(again.objects, found.objects, strict=True):
        assert (one.id, one.frames, one.scale_from) == (two.id, two.frames, two.scale_from)
        np.testing.assert_array_equal(one.poses, two.poses)
        np.testing.assert_array_equal(one.extent, two.extent)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: (folder / "objects.json").unlink(), "has no objects.json"),
        (lambda folder: shutil.rmtree(folder / "masks"), "has no masks"),
        (lambda folder: altered(folder, format=99), "objects.json is damaged .*format 99"),
        (lambda folder: altered(folder, scale_from="x"), "scale_from is 'x'"),
        (lambda folder: altered(folder, frames=[10]), "labelled in frames that do not exist"),
    ],
)
def test_incomplete_or_damaged_folder_is_refused(found, tmp_path, damage, words):
    found.save(tmp_path / "copy")
    damage(tmp_path / "copy")
    with pytest.raises(FormatError, match=words):
        tisfm.Reconstruction.load(tmp_path / "copy")


def altered(folder, **about):
    """Change the record of the first object, or of all objects."""
    record = json.loads((folder / "objects.json").read_text())
    thing = record["objects"][0]
    if "frames" in about:
        thing.update(boxes=thing["boxes"][:1], poses=thing["poses"][:1])
    target = record if "format" in about else thing
    target.update(about)
    (folder / "objects.json").write_text(json.dumps(record))


def test_rescaling_includes_objects(found):
    first, last = 0, len(found) - 1
    moved = np.linalg.norm(found.poses[last, :3, 3] - found.poses[first, :3, 3])
    twice = found.rescaled(first, last, 2 * moved)
    for one, two in zip(found.objects, twice.objects, strict=True):
        np.testing.assert_allclose(two.poses[:, :3, 3], 2 * one.poses[:, :3, 3])
        known = np.isfinite(one.poses).all()
        np.testing.assert_allclose(two.extent, (2 if known else 1) * one.extent)


def test_result_without_objects_has_no_labels():
    frames = film(bodies=0).frames[:4]
    result = tisfm.reconstruct(list(frames), camera=film().camera, depth_of="none")
    assert result.objects == ()
    assert not result.labels(0).any()
    assert not (result.folder / "masks").exists()


def test_stream_refuses_objects():
    frames = list(film().frames[:4])
    with pytest.raises(ValueError, match="motion"):
        next(tisfm.reconstruct_stream(iter(frames), settings=OBJECTS))


def test_masked_pixels_have_no_object():
    mask = np.full(film().frames.shape[1:], 255, np.uint8)
    mask[:, :80] = 0
    result = tisfm.reconstruct(
        list(film().frames[:5]), camera=film().camera, settings=OBJECTS, mask=mask, depth_of="none"
    )
    assert not any(result.labels(k)[:, :80].any() for k in range(len(result)))


@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        ("constant", (48, 64)),
        ("cut", (48, 64)),
        pytest.param("noise", (48, 64), marks=pytest.mark.nightly),
        pytest.param("two frames", (61, 83), marks=pytest.mark.nightly),
        pytest.param("moving stripes", (61, 83), marks=pytest.mark.nightly),
    ],
)
def test_frames_without_a_path_have_valid_labels(kind, shape):
    random = np.random.default_rng(3)
    count = 2 if kind == "two frames" else 6
    if kind == "constant":
        frames = np.full((count, *shape), 90, np.uint8)
    elif kind == "moving stripes":
        columns = np.arange(shape[1])
        stripes = [128 + 90 * np.sin((columns + 2 * k) / 3) for k in range(count)]
        frames = np.uint8([np.tile(row, (shape[0], 1)) for row in stripes])
    else:
        frames = random.integers(0, 256, (count, *shape), np.uint8)
        frames = np.stack([cv2.GaussianBlur(frame, (0, 0), 2) for frame in frames])
        if kind == "cut":
            frames[1:3], frames[4:] = frames[0], frames[3]
    result = tisfm.reconstruct(list(frames), camera=tisfm.Camera(focal=70.0), settings=OBJECTS)
    assert len(result) == count
    for frame in range(count):
        labels = result.labels(frame)
        assert labels.shape == shape
        assert set(np.unique(labels)) <= {0, *(thing.id for thing in result.objects)}


@pytest.mark.parametrize("shape", [(40, 60), (41, 61)])
def test_labels_are_enlarged_to_the_size_of_frames(shape):
    small = np.zeros(((shape[0] + 1) // 2, (shape[1] + 1) // 2), np.uint8)
    small[5:12, 6:20] = 3
    large = enlarge_labels(small, 0.5, shape)
    assert large.shape == shape
    assert (large[11:23, 13:39] == 3).all()
    assert not large[:9].any()
    np.testing.assert_array_equal(enlarge_labels(small, 1.0, small.shape), small)


def tracked(number, frames, *, core_frames=4, velocity=(10.0, 0.0), pixel_count=100, evidence=3.0):
    """Return a square that was seen in these frames."""
    mask = np.zeros((100, 200), bool)
    mask[40:60, 80:100] = True
    return TrackedObject(
        id=number,
        last_frame=frames[-1],
        mask=mask,
        velocity=np.array(velocity),
        histogram=np.array([0.5, 0.5, 0.0]),
        core_frames=core_frames,
        pixel_count=pixel_count,
        motions=dict.fromkeys(frames, np.array(velocity)),
        positions=dict.fromkeys(frames, mask_position(mask)),
        evidence=dict.fromkeys(frames, evidence),
    )


def test_labels_are_for_objects_with_a_core_in_enough_frames():
    objects = {
        1: tracked(1, range(10)),
        2: tracked(2, range(3)),
        3: tracked(3, range(10), core_frames=2),
        4: tracked(4, range(10), core_frames=3),
    }
    assert final_labels(objects, {}, 10).tolist() == [0, 1, 0, 0, 2]
    assert final_labels(objects, {}, 3).tolist() == [0, 1, 2, 3, 4]  # a short sequence


@pytest.mark.parametrize(
    ("velocity", "touching", "labels"),
    [((10, 2), 7, [0, 1, 1]), ((10, 2), 5, [0, 1, 2]), ((-10, 0), 10, [0, 1, 2])],
)
def test_parts_of_an_object_touch_and_move_alike(velocity, touching, labels):
    objects = {
        1: tracked(1, range(10), pixel_count=50),
        2: tracked(2, range(10), velocity=velocity),
    }
    assert final_labels(objects, {(1, 2): touching}, 10).tolist() == labels


def test_parts_that_stay_together_are_one_object():
    objects = {
        1: tracked(1, range(10), velocity=(0, 0), pixel_count=50),
        2: tracked(2, range(10), velocity=(0, 0)),
    }
    for frame in range(10):  # a wheel goes up and down beside the frame of a bicycle
        objects[1].motions[frame] = np.array([0, 4.0 * (-1) ** frame])
    assert final_labels(objects, {(1, 2): 7}, 10).tolist() == [0, 1, 1]
    assert final_labels(objects, {(1, 2): 5}, 10).tolist() == [0, 1, 2]
    for frame in range(10):
        objects[1].motions[frame] = np.array([0, 4.0])  # 40 px in all; a square has 20 px
    assert final_labels(objects, {(1, 2): 7}, 10).tolist() == [0, 1, 2]
    for frame in range(10):  # two that pass each other slowly
        objects[1].motions[frame], objects[2].motions[frame] = np.array([[0.3, 0], [-0.3, 0]])
    assert final_labels(objects, {(1, 2): 7}, 10).tolist() == [0, 1, 2]


def test_labels_that_hardly_ever_move_clearly_are_dropped():
    objects = {
        1: tracked(1, range(10), evidence=0.5),
        2: tracked(2, range(10), evidence=0.5),
        3: tracked(3, range(10)),
    }
    objects[2].evidence[4] = 2.5  # clear in a tenth of its frames
    assert final_labels(objects, {}, 10).tolist() == [0, 0, 1, 2]


def test_known_object_takes_pixels_if_it_moved_clearly():
    clear, unclear = tracked(1, range(5)), tracked(2, range(5), evidence=0.5)
    assert not clear.is_clear(400)  # it has too few frames with a core
    for obj in (clear, unclear):
        obj.core_frames = 3
        obj.add_core(True)
    assert clear.is_clear(400) and clear.is_clear(800)  # a square has 400 px
    assert not clear.is_clear(900)
    assert not unclear.is_clear(400)
    clear.evidence[5], unclear.evidence[5] = -1.0, 3.0  # later frames do not count
    assert clear.is_clear(400) and not unclear.is_clear(400)


def film_of_a_plain_car(count=16):
    """Return image motion, evidence and masks of a car whose body soon gives no evidence."""
    height, width, speed = 120, 240, 3
    random = np.random.default_rng(0)
    road, car = (
        cv2.GaussianBlur(random.uniform(-300, 555, (height, width)), (0, 0), 1.5).clip(0, 255)
        for _ in range(2)
    )
    motion = ImageMotion(tisfm.Camera(focal=200.0), TRACKING_SETTINGS)
    masks, evidence = [], []
    for frame in range(count):
        mask = np.zeros((height, width), bool)
        mask[40:80, 30 + speed * frame : 90 + speed * frame] = True
        masks.append(mask)
        moved_car = np.roll(car, speed * frame, axis=1)
        motion._frames.append(np.where(mask, moved_car, road).astype(np.float32))
        shows_motion = mask.copy()
        if frame > 6:
            shows_motion[50:] = False  # the windows alone
        total = np.where(shows_motion, 3.0, -1.0).astype(np.float32)
        evidence.append(Evidence(total=total, weight=np.ones_like(total)))
    for before, after in itertools.pairwise(masks):
        flows = [np.zeros((height, width, 2), np.float32) for _ in range(2)]
        flows[0][before], flows[1][after] = (speed, 0), (-speed, 0)
        motion._pairs.append(FlowPair(forward=flows[0], backward=flows[1]))
    return motion, evidence, masks


def test_part_without_evidence_that_moves_along_stays_in_the_object():
    motion, evidence, masks = film_of_a_plain_car()
    labels = list(ObjectTracker(motion, evidence, accumulate_evidence(motion, evidence)).labels())
    assert set(np.unique(labels)) == {0, 1}
    scores = [iou(a == 1, b) for a, b in zip(labels, masks, strict=True)]
    assert min(scores) > 0.8  # 0.55 without what moves along


def test_shared_motion_is_near_the_object_and_not_that_of_the_surroundings():
    motion, _, masks = film_of_a_plain_car(3)
    core = masks[1].copy()
    core[:, 84:] = False  # 51 of the 60 columns
    shared = SmoothMotions(motion, 1).shared_motion(core, core)
    assert not (shared & ~masks[1]).any()
    assert (shared & masks[1] & ~core).sum() > 0.6 * (masks[1] & ~core).sum()
    assert not SmoothMotions(motion, 1).shared_motion(np.ones_like(core), core).any()
    neighbour = masks[1] & ~core  # it belongs to another object
    assert not (SmoothMotions(motion, 1).shared_motion(core, masks[1]) & neighbour).any()
    motions = SmoothMotions(motion, 1)
    for _, valid in motions._flows:
        valid &= ~core
    assert not motions.shared_motion(core, core).any()


def test_ground_below_a_standing_foot_is_not_in_the_object():
    """The ground moves faster towards the camera, and at the foot as the object does."""
    height, width = 120, 160
    flow = np.zeros((height, width, 2), np.float32)
    flow[..., 0] = 0.06 * np.arange(height)[:, None]
    body = np.zeros((height, width), bool)
    body[20:90, 70:90] = True
    rows = np.arange(20, 90)
    # From 9 px at the head to the 5.4 px of the ground at the foot.
    flow[20:90, 70:90, 0] = np.interp(rows, [20, 75, 90], [9.0, 7.0, 5.4])[:, None]
    motion = ImageMotion(tisfm.Camera(focal=150.0), TRACKING_SETTINGS)
    for _ in range(2):
        motion._frames.append(np.zeros((height, width), np.float32))
    motion._pairs.append(FlowPair(forward=flow, backward=-flow))
    motions = SmoothMotions(motion, 0)
    for _, valid in motions._flows:
        valid[:] = True
    shared = motions.shared_motion(body, body)
    assert shared[20:60, 70:90].mean() > 0.5 and not (shared & ~body).any()


def test_object_reappears_where_its_velocity_leads():
    hidden = tracked(7, range(5))
    ahead, behind = (np.array([89.5 + way, 49.5, 20.0]) for way in (40, -40))
    assert most_similar_object([hidden], 8, ahead, hidden.histogram) == 7
    assert most_similar_object([hidden], 8, behind, hidden.histogram) == 0
    assert most_similar_object([hidden], 8, ahead, np.array([0.1, 0.1, 0.8])) == 0
    assert most_similar_object([hidden], 4, ahead, hidden.histogram) == 0  # it is still seen
    assert (
        most_similar_object([hidden], 21, np.add(ahead, (130, 0, 0)), hidden.histogram) == 0
    )  # too late


def test_mask_in_the_next_frame_is_moved_by_the_velocity():
    square = tracked(1, range(5), velocity=(10.0, -4.0))
    moved = np.roll(square.mask, (-4, 10), axis=(0, 1))
    np.testing.assert_array_equal(ObjectTracker._predicted_mask(square, enlarge=False), moved)
    enlarged = ObjectTracker._predicted_mask(square)
    assert enlarged[moved].all() and enlarged.sum() > moved.sum()


def test_json_of_an_object():
    poses = np.stack([np.eye(4), np.full((4, 4), np.nan)])
    thing = MovingObject(
        id=2,
        frames=(3, 4),
        boxes=np.array([[1, 2, 3, 4], [1, 2, 3, 5]], np.int32),
        poses=poses,
        extent=np.array([1.0, 2, 3]),
        scale_from="contact",
    )
    again = MovingObject.from_json(json.loads(json.dumps(thing.as_json(), allow_nan=False)))
    np.testing.assert_array_equal(again.poses, poses)
    np.testing.assert_array_equal(again.boxes, thing.boxes)
    assert (again.id, again.frames, again.scale_from) == (2, (3, 4), "contact")


@pytest.mark.nightly  # the tests above use rendered frames
@pytest.mark.parametrize(
    ("clip", "least"), [("camel", 0.7), ("car-roundabout", 0.8), ("car-shadow", 0.7)]
)
def test_real_clips_of_one_moving_object(clip, least):
    folder = DATA / "davis" / clip
    if not folder.exists():
        pytest.skip(f"{folder} is not there")
    pictures = sorted((folder / "images").iterdir())[:30]
    masks = sorted((folder / "masks").iterdir())[:30]
    frames = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pictures]
    finder = SequenceLabels(tisfm.Camera(focal=1.2 * frames[0].shape[1]))
    for frame in frames:
        finder.add(frame)
    labels = list(finder.labels())
    true = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 127 for path in masks]
    scores = [
        np.mean([iou(a == k, b) for a, b in zip(labels, true, strict=True)]) for k in range(1, 4)
    ]
    assert max(scores) > least


@pytest.mark.parametrize("shape", [(120, 161), (480, 640), (1081, 1919)])
def test_camera_of_smaller_frames_has_its_center_in_their_middle(shape):
    motion = ImageMotion(tisfm.Camera(focal=500.0), TRACKING_SETTINGS)
    motion.add(np.zeros(shape, np.uint8))
    height, width = motion.grey(0).shape
    x, y = motion.camera().center_for(height, width)
    assert abs(x - (width - 1) / 2) <= 0.5
    assert abs(y - (height - 1) / 2) <= 0.5
    assert motion.camera(tisfm.Camera(focal=300.0)).focal == 300.0 * motion.scale
