"""Moving objects with given labels."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import path_error
from tests.rendered import bodies_film
from tisfm.evaluation.moving_objects import compare_object_paths, has_true_paths
from tisfm.formats.label_picture import write_label_png
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS, ImageMotion
from tisfm.reconstruction.objects.label_propagation import propagate_labels
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.result.folder import write_objects
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.scenes import bodies_path

OBJECTS = tisfm.Settings.preset("fast", motion="objects")
FEW, SMALL = 6, (120, 160)
COUNT = 16
WHOLE = COUNT, (240, 320)
CARRIED = 8, (120, 160)
IDS = np.array([0, 5, 3, 254], np.uint8)  # ids of the bodies in the given labels


def film(count=FEW, size=SMALL):
    """Return a film to follow labels in; `count` and `size` of `WHOLE` also give object paths."""
    return bodies_film(bodies_path(count), *size)


def labels(*of):
    return IDS[film(*of).labels]


def reconstructed(*of, **options):
    options = {"depth_of": "none", "camera": film(*of).camera, "settings": OBJECTS} | options
    return tisfm.reconstruct(list(film(*of).frames), **options)


def labels_of(result):
    return np.stack([result.labels(k) for k in range(len(result))])


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Return the reconstruction of the film with its true labels."""
    folder = tmp_path_factory.mktemp("given") / "result"
    return reconstructed(*WHOLE, labels=labels(*WHOLE), folder=folder, depth_of="keyframes")


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return the reconstruction of the short film with its true labels."""
    return reconstructed(labels=labels(), folder=tmp_path_factory.mktemp("short") / "result")


def test_given_labels_are_kept(given):
    np.testing.assert_array_equal(labels_of(given), labels(*WHOLE))
    assert [thing.id for thing in given.objects] == [3, 5, 254]
    for thing in given.objects:
        shown = [k for k in range(COUNT) if (labels(*WHOLE)[k] == thing.id).any()]
        assert list(thing.frames) == shown
        for frame, box in zip(thing.frames, thing.boxes, strict=True):
            assert tuple(box) == cv2.boundingRect(np.uint8(labels(*WHOLE)[frame] == thing.id))


def test_given_labels_turn_off_the_search(monkeypatch):
    def never(*arguments):
        raise AssertionError

    monkeypatch.setattr(SequenceLabels, "add", never)
    monkeypatch.setattr(ImageMotion, "add", never)
    assert len(reconstructed(labels=labels()).objects) == 3


def test_path_ignores_moving_objects(given):
    assert path_error(given.poses, film(*WHOLE).poses) < 0.003
    depth, at_rest = given.depth(given.keyframes[0]), labels(*WHOLE)[given.keyframes[0]] == 0
    true = film(*WHOLE).depth[given.keyframes[0]]
    ratio = (true / depth)[at_rest & np.isfinite(depth)]
    assert np.abs(ratio / np.median(ratio) - 1).mean() < 0.03


def angle(first, last):
    turn = np.linalg.inv(first) @ last
    return np.arccos((np.trace(turn[:3, :3]) - 1) / 2)


def test_object_has_a_path(given):
    thing, true = given.objects[1], film(*WHOLE).body_poses[0]
    assert thing.id == 5 and np.isfinite(thing.poses).all()
    assert thing.scale_from in ("contact", "around")  # no size is given
    assert angle(thing.poses[0], thing.poses[-1]) == pytest.approx(
        angle(true[0], true[-1]), rel=0.4
    )


def test_masks_that_hold_labels_are_labels(short):
    result = reconstructed(mask=labels())
    np.testing.assert_array_equal(labels_of(result), labels())
    assert [thing.id for thing in result.objects] == [thing.id for thing in short.objects]


def test_masks_of_a_result_are_labels_of_the_next(short):
    result = reconstructed(labels=short.folder)
    np.testing.assert_array_equal(labels_of(result), labels())
    half = reconstructed(mask=short.folder / "masks", step=2)
    np.testing.assert_array_equal(labels_of(half), labels()[::2])


def test_masks_of_every_second_frame_go_by_names(tmp_path):
    reconstructed(labels=labels(), step=2, folder=tmp_path / "half")
    again = reconstructed(labels=tmp_path / "half", step=2)
    np.testing.assert_array_equal(labels_of(again), labels()[::2])


def test_void_label_is_not_an_object():
    void = labels()
    void[:, :10] = 255
    result = reconstructed(labels=void, poses=film().poses, depth_of="keyframes")
    np.testing.assert_array_equal(labels_of(result), np.where(void == 255, 0, void))
    key = result.keyframes[0]
    assert np.isinf(result.inverse_depth_std(key)[:10]).all()
    assert not np.isinf(result.inverse_depth_std(key)[15:]).all()


def test_labels_move_with_the_lens():
    camera = tisfm.Camera(focal=film().camera.focal, distortion=(-0.1, 0, 0, 0))
    result = reconstructed(labels=labels(), camera=camera)
    height, width = film().frames.shape[1:]
    matrix = np.array([[camera.focal, 0, (width - 1) / 2], [0, camera.focal, (height - 1) / 2],
                       [0, 0, 1]])  # fmt: skip
    x, y = cv2.initUndistortRectifyMap(
        matrix, np.array(camera.distortion), None, matrix, (width, height), cv2.CV_32FC1
    )
    inside = (x > 1) & (x < width - 2) & (y > 1) & (y < height - 2)
    expected = cv2.remap(labels()[4], x, y, cv2.INTER_NEAREST)
    found = result.labels(4)
    assert (found == expected)[inside].mean() > 0.995
    assert (found != labels()[4]).mean() > 0.005


def test_known_poses_and_labels():
    result = reconstructed(labels=labels(), poses=film().poses, depth_of="keyframes")
    np.testing.assert_array_equal(labels_of(result), labels())
    np.testing.assert_allclose(result.poses, film().poses)


# Frames without labels


def iou(one, two):
    return (one & two).sum() / max(1, (one | two).sum())


@pytest.mark.parametrize(
    ("known", "least"),
    [((0, CARRIED[0] - 1), 0.85), pytest.param((2,), 0.65, marks=pytest.mark.nightly)],
)
def test_labels_are_propagated_to_other_frames(known, least):
    """From a single labelled frame, an occluder may also take the pixels that it uncovers."""
    result = reconstructed(*CARRIED, labels={k: labels(*CARRIED)[k] for k in known})
    found = labels_of(result)
    for k in known:
        np.testing.assert_array_equal(found[k], labels(*CARRIED)[k])
    assert [thing.id for thing in result.objects] == [3, 5, 254]
    for number in (3, 5, 254):
        scores = [
            iou(a == number, b == number) for a, b in zip(found, labels(*CARRIED), strict=True)
        ]
        assert np.mean(scores) > least
        assert np.mean(scores[:6]) > 0.85


def test_labelled_object_at_rest_is_followed():
    """Objects are not searched: the given labels define them, also at rest."""
    box = np.zeros_like(labels()[0])
    box[20:60, 50:90] = 9
    result = reconstructed(labels={0: box})
    assert {thing.id for thing in result.objects} == {9}
    assert all((result.labels(k) == 9).sum() > 800 for k in range(FEW))


def test_labels_come_from_the_nearest_frame():
    motion = ImageMotion(tisfm.Camera(focal=50.0), TRACKING_SETTINGS)
    random = np.random.default_rng(5)
    grey = cv2.GaussianBlur(random.integers(0, 256, (40, 48), np.uint8), (0, 0), 1.5)
    for _ in range(9):
        motion.add(grey)
    of = {2: np.zeros((40, 48), np.uint8), 6: np.zeros((40, 48), np.uint8)}
    of[2][10:30, 10:30], of[6][10:30, 10:30] = 1, 2
    found = {k: int(labels.max()) for k, labels in propagate_labels(motion, [2, 6], of.get)}
    assert found == {0: 1, 1: 1, 3: 1, 4: 1, 5: 2, 7: 2, 8: 2}


# Errors


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match=r'motion is "camera": expected motion="objects"'):
        reconstructed(labels=labels(), settings=None)
    with pytest.raises(ValueError, match=r"labels has no labels for a selected frame of frames"):
        reconstructed(labels={1: labels()[1]}, step=2)
    with pytest.raises(ValueError, match="give booleans"):
        reconstructed(mask=np.uint8(labels() > 0))
    with pytest.raises(ValueError, match="0 or 255 everywhere"):
        reconstructed(labels=np.where(labels() > 0, 255, 0))


def test_result_does_not_replace_its_labels(short):
    before = labels_of(short)
    with pytest.raises(ValueError, match="the output folder: give another folder"):
        reconstructed(labels=short.folder, folder=short.folder)
    np.testing.assert_array_equal(labels_of(short), before)


def test_palette_pictures_of_one_object(tmp_path):
    """Indexed pictures of a single object, as in DAVIS."""
    for k, one in enumerate(labels()):
        write_label_png(tmp_path / f"{k:05d}.png", np.uint8(one == 5))
    result = reconstructed(mask=tmp_path)
    np.testing.assert_array_equal(labels_of(result), labels() == 5)
    assert [thing.id for thing in result.objects] == [1]


def test_labels_of_a_result_are_not_undistorted_twice(tmp_path):
    camera = tisfm.Camera(focal=film().camera.focal, distortion=(-0.15, 0, 0, 0))
    first = reconstructed(labels=labels(), camera=camera, folder=tmp_path / "one")
    again = reconstructed(labels=first.folder, camera=camera)
    np.testing.assert_array_equal(labels_of(again), labels_of(first))
    anew = tisfm.reconstruct(
        first.folder / "frames",
        labels=first.folder,
        camera=first.camera,
        settings=OBJECTS,
        depth_of="none",
    )
    np.testing.assert_array_equal(labels_of(anew), labels_of(first))
    for options in ({}, {"camera": None}, {"camera": camera.with_focal(300.0)}):
        with pytest.raises(
            ValueError, match="without lens distortion and rolling shutter: give its camera"
        ):
            reconstructed(labels=first.folder, **options)


@pytest.mark.nightly
def test_object_visible_only_in_another_piece_has_no_path():
    frames = [*film(10).frames, *(255 - film().frames[:, :, ::-1])]
    last = np.where(labels()[:, :, ::-1] > 0, 7, 0)
    result = tisfm.reconstruct(
        frames,
        labels=[*labels(10), *last.astype(np.uint8)],
        camera=film().camera,
        settings=OBJECTS,
        depth_of="keyframes",
        object_sizes={7: 0.4},
    )
    (thing,) = (thing for thing in result.objects if thing.id == 7)
    assert np.isnan(thing.poses).all() and np.isnan(thing.extent).all()
    assert thing.scale_from == "none" and thing.message


def test_paths_against_true_ones(given, tmp_path):
    things = [
        MovingObject(
            id=body,
            frames=tuple(range(COUNT)),
            boxes=np.zeros((COUNT, 4), np.int32),
            poses=poses,
            extent=size,
        )
        for body, (poses, size) in enumerate(
            zip(film(*WHOLE).body_poses, film(*WHOLE).body_sizes, strict=True), start=1
        )
    ]
    assert not has_true_paths(tmp_path)
    write_objects(tmp_path, things)
    np.savetxt(tmp_path / "poses.txt", film(*WHOLE).poses[:, :3].reshape(-1, 12))
    assert has_true_paths(tmp_path)
    errors = compare_object_paths(given.folder, tmp_path, {1: 5, 2: 99, 3: 254})
    # Body 3 hardly turns in so few frames: rounding decides whether it has a path.
    assert {1} <= set(errors) <= {1, 3}
    assert errors[1].frames == COUNT and errors[1].share < 0.1
    with pytest.raises(ValueError, match="has 8 frames at a step of 2"):
        compare_object_paths(given.folder, tmp_path, {1: 5}, step=2)


def test_mask_iterators_cannot_hold_labels():
    with pytest.raises(ValueError, match="numbers other than 0 and 255: give them as labels="):
        reconstructed(mask=iter(labels()))
    result = reconstructed(mask=[one.tolist() for one in labels()])
    np.testing.assert_array_equal(labels_of(result), labels())
    with pytest.raises(
        ValueError, match="mask has numbers of moving objects, but labels are given"
    ):
        reconstructed(mask=labels(), labels=labels())
