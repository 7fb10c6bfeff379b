"""Moving objects of known size."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tisfm
from tests.rendered import bodies_film
from tisfm.reconstruction.objects.object_depth import longest_side, trimmed_extent
from tisfm.scenes import bodies_path

OBJECTS = tisfm.Settings.preset("fast", motion="objects")
COUNT, LENGTH = 16, 0.6  # m, of the first body


def film():
    return bodies_film(bodies_path(COUNT), 240, 320)


@cache
def sized(size):
    """Return the reconstruction of the film with a size of the first body."""
    return tisfm.reconstruct(
        list(film().frames),
        camera=film().camera,
        settings=OBJECTS,
        labels=film().labels,
        poses=film().poses,
        object_sizes=None if size is None else {1: size},
        depth_of="keyframes",
    )


def own_depth(result):
    """Return the median ratio of true to estimated depth of the first body."""
    key = result.keyframes[0]
    return np.nanmedian((film().depth[key] / result.depth(key))[film().labels[key] == 1])


def test_known_size_gives_the_scale(tmp_path):
    result = sized(LENGTH)
    thing = result.objects[0]
    assert thing.id == 1 and thing.scale_from == "size"
    assert all(other.scale_from != "size" for other in result.objects[1:])
    assert np.linalg.norm(thing.extent) == pytest.approx(np.linalg.norm((0.6, 0.5, 0.4)), rel=0.15)
    assert own_depth(result) == pytest.approx(1, rel=0.12)
    result.save(tmp_path / "saved")
    assert tisfm.Reconstruction.load(tmp_path / "saved").objects[0].scale_from == "size"


@pytest.mark.nightly
def test_doubled_size_doubles_the_distance():
    once, twice = sized(LENGTH), sized(2 * LENGTH)
    one, two = once.objects[0], twice.objects[0]
    np.testing.assert_allclose(two.extent, 2 * one.extent)
    for frame, near, far in zip(one.frames, one.poses, two.poses, strict=True):
        np.testing.assert_allclose(far[:3, :3], near[:3, :3])
        camera = film().poses[frame][:3, 3]
        np.testing.assert_allclose(far[:3, 3] - camera, 2 * (near[:3, 3] - camera), atol=1e-9)
    assert own_depth(once) / own_depth(twice) == pytest.approx(2, rel=1e-3)
    key = once.keyframes[0]
    others = film().labels[key] != 1
    rounded = 2**-10  # depth has 11 significant bits, and two scales are compared
    np.testing.assert_allclose(once.depth(key)[others], twice.depth(key)[others], rtol=rounded)


@pytest.mark.parametrize(
    ("turn", "faces"),
    [
        ((0.3, 0.5, -0.2), 3),
        pytest.param((0, 0, 0), 1, marks=pytest.mark.nightly),
        pytest.param((1.0, 0.2, 0.7), 1, marks=pytest.mark.nightly),
    ],
)
def test_longest_side_is_that_of_a_turned_box(turn, faces):
    """Three faces or one face of a box of 4.5 × 1.8 × 1.5 are visible."""
    sides, random = np.array([4.5, 1.8, 1.5]), np.random.default_rng(2)
    points = []
    for face in (2, 1, 0)[:faces]:
        some = random.uniform(-0.5, 0.5, (400, 3)) * sides
        some[:, face] = sides[face] / 2
        points.append(some)
    turned = np.concatenate(points) @ Rotation.from_rotvec(turn).as_matrix().T
    assert longest_side(turned) == pytest.approx(4.5, rel=0.08)
    assert longest_side(10 * turned) == pytest.approx(10 * longest_side(turned))


def test_outliers_do_not_change_the_extent():
    points = np.random.default_rng(0).uniform(0, 1, (1000, 3))
    points[:10] = 100
    np.testing.assert_allclose(trimmed_extent(points), 1, atol=0.1)


# Errors


@pytest.mark.parametrize(
    ("sizes", "error", "words"),
    [
        ([4.5], TypeError, "expected lengths by ids"),
        ({"1": 4.5}, TypeError, "has the id '1': expected a whole number"),
        ({1: "4.5"}, TypeError, "object_sizes.1. is '4.5': expected a length"),
        ({1: 0.0}, ValueError, "object_sizes.1. is 0.0: expected a positive length"),
        ({1: np.inf}, ValueError, "expected a positive length"),
        (
            {1: 0.5, 9: 1},
            ValueError,
            "without an object: 9; the ids of moving objects are: 1, 2, 3",
        ),
    ],
)
def test_invalid_sizes_are_refused(sizes, error, words):
    with pytest.raises(error, match=words):
        tisfm.reconstruct(
            list(film().frames[:3]),
            camera=film().camera,
            settings=OBJECTS,
            labels=film().labels[:3],
            object_sizes=sizes,
        )


def test_sizes_of_missing_objects_are_refused():
    still = [film().frames[0][:48, :64]] * 3
    with pytest.raises(
        ValueError, match="without an object: 1; the ids of moving objects are: none"
    ):
        tisfm.reconstruct(
            still, camera=tisfm.Camera(focal=60.0), settings=OBJECTS, object_sizes={1: 1.0}
        )
    with pytest.raises(ValueError, match='motion is "camera": expected motion="objects"'):
        tisfm.reconstruct(still, object_sizes={1: 1.0})
