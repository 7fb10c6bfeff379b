"""Depth of moving objects whose motion shows none, from the places where they stand."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tisfm
from tests.rendered import walkers_film
from tisfm.reconstruction.objects.standing_depth import (
    FrameMeasures,
    find_standing_depth,
    find_standing_depths,
    measure_objects,
)
from tisfm.reconstruction.result.moving_object import labelled_objects
from tisfm.scenes import bodies_path

FOCAL, SIZE = 100.0, (90, 120)
GROUND = 1.5  # m below the camera
COUNT = 12
MEASURES = FrameMeasures(
    frame=0, contact=0.25, slope=0.5, around=0.2, height=40.0, length=40.0, thickness=0.02
)


def measures_of(depth, **changes):
    """Return measures of an object of 1.6 m on the ground, at a depth in each frame."""
    of_frame = {name: np.broadcast_to(values, len(depth)) for name, values in changes.items()}
    return [
        replace(
            MEASURES,
            **{"frame": k, "contact": 1 / z, "height": 1.6 * FOCAL / z, "length": 1.6 * FOCAL / z}
            | {name: values[k] for name, values in of_frame.items()},
        )
        for k, z in enumerate(depth)
    ]


def ground(frame=0):
    """Return the inverse depth of a ground below a wall 20 m away, and its deviation."""
    rows = np.arange(SIZE[0]) - (SIZE[0] - 1) / 2
    column = np.maximum(rows / (FOCAL * GROUND), 0.05)
    inverse_depth = np.broadcast_to(column[:, None], SIZE).astype(np.float32)
    return inverse_depth, 0.01 * inverse_depth


def labels_at(depth, legs=True):
    """Return labels of a box of 1.6 m that stands on the ground, or of its upper half."""
    labels = np.zeros(SIZE, np.uint8)
    foot = (SIZE[0] - 1) / 2 + FOCAL * GROUND / depth
    top = foot - FOCAL * 1.6 / depth
    end = foot if legs else (foot + top) / 2
    labels[round(top) : round(end) + 1, 50:62] = 1
    return labels


def standing(labels, static_depth=ground, **options):
    """Return the depth of the object in some labels."""
    (obj,) = labelled_objects(len(labels), lambda k: labels[k])
    measures = measure_objects([obj], FOCAL, static_depth, lambda k: labels[k])
    return find_standing_depth(measures[1], FOCAL, **options)


def test_an_object_is_as_far_away_as_the_ground_at_its_feet():
    depth = np.linspace(4, 5, COUNT)
    found = standing([labels_at(z) for z in depth], given_labels=range(COUNT))
    assert found.scale_from == "contact" and found.frames == tuple(range(COUNT))
    # The ground is seen 3 px below the feet.
    np.testing.assert_allclose(1 / found.inverse_depth, depth, rtol=0.12)
    assert (found.deviation < 0.1 * found.inverse_depth).all()


def test_feet_without_a_label_hardly_matter_for_a_while():
    depth = np.full(COUNT, 4.0)
    exact = standing([labels_at(z) for z in depth])
    hidden = [labels_at(z, legs=k not in (3, 4, 5)) for k, z in enumerate(depth)]
    np.testing.assert_allclose(standing(hidden).inverse_depth, exact.inverse_depth, rtol=0.03)
    without = standing([labels_at(z, legs=False) for z in depth])
    assert (without.inverse_depth < 0.7 * exact.inverse_depth).all()


def test_a_found_label_has_a_less_certain_end():
    labels = [labels_at(4.0)] * COUNT
    found, given = (standing(labels, given_labels=frames) for frames in ((), range(1, COUNT)))
    np.testing.assert_array_equal(found.inverse_depth, given.inverse_depth)
    assert (found.deviation[1:] > given.deviation[1:]).all()
    assert found.deviation[0] == given.deviation[0]  # its label was propagated


def test_a_wall_below_an_object_is_no_ground():
    def wall(frame):
        return np.full(SIZE, 0.1, np.float32), np.full(SIZE, 0.001, np.float32)

    found = standing([labels_at(4.0)] * COUNT, wall)
    assert found.scale_from == "around"
    np.testing.assert_allclose(found.inverse_depth, 0.1, rtol=1e-3)
    assert (found.deviation > 0.3 * found.inverse_depth).all()


def test_frames_without_depth_follow_from_the_height():
    depth = np.linspace(4, 5, COUNT)
    labels = [labels_at(z) for z in depth]
    known = standing(labels)
    some = standing(labels, lambda frame: ground() if frame % 4 == 0 else None)
    np.testing.assert_allclose(some.inverse_depth, known.inverse_depth, rtol=0.05)
    assert standing(labels, lambda frame: None) is None


def test_a_known_size_gives_the_distance():
    labels = [labels_at(4.0)] * COUNT
    found = standing(labels, lambda frame: None, size=1.6)
    assert found.scale_from == "size"
    np.testing.assert_allclose(1 / found.inverse_depth, 4.0, rtol=0.03)
    doubled = standing(labels, size=3.2)
    np.testing.assert_allclose(2 * doubled.inverse_depth, found.inverse_depth, rtol=1e-6)


def test_depth_is_smooth_in_time():
    random = np.random.default_rng(0)
    noisy = 4 * np.exp(random.normal(0, 0.1, 30))
    found = find_standing_depth(measures_of(np.full(30, 4.0), contact=1 / noisy), FOCAL)
    assert np.abs(np.diff(np.log(found.inverse_depth))).max() < 0.02
    np.testing.assert_allclose(1 / found.inverse_depth, 4, rtol=0.1)


@pytest.mark.parametrize(("first", "last"), [(20.0, 5.0), (5.0, 20.0), (25.0, 8.0)])
def test_steady_approach_is_no_outlier(first, last):
    depth = np.linspace(first, last, 16)
    found = find_standing_depth(measures_of(depth), FOCAL)
    np.testing.assert_allclose(1 / found.inverse_depth, depth, rtol=0.12)


def test_feet_behind_another_label_are_hidden():
    labels = [labels_at(4.0) for _ in range(COUNT)]
    for number, frame_labels in enumerate(labels):
        if number >= 4:
            foot = np.flatnonzero((frame_labels == 1).any(axis=1))[-1]
            frame_labels[foot - 18 :, 40:72] = 2  # an ignored pixel does the same
    (obj, _) = labelled_objects(COUNT, lambda k: labels[k])
    measures = measure_objects([obj], FOCAL, ground, lambda k: labels[k])[1]
    hidden = [np.isnan(item.contact) and np.isnan(item.height) for item in measures]
    assert hidden == [number >= 4 for number in range(COUNT)]
    found = find_standing_depth(measures, FOCAL)
    np.testing.assert_allclose(1 / found.inverse_depth, 4.0, rtol=0.05)


def test_a_cut_object_has_no_length():
    labels = [labels_at(4.0) for _ in range(COUNT)]
    for frame_labels in labels:
        frame_labels[:, :52] = 0  # move the cut part to the left border of the frame
        frame_labels[:] = np.roll(frame_labels, -52, axis=1)
    found = standing(labels, size=1.6)
    assert found.scale_from == "contact"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_frames_have_depth(count):
    found = find_standing_depth(measures_of(np.full(count, 4.0)), FOCAL)
    np.testing.assert_allclose(found.inverse_depth, 0.25, rtol=1e-6)
    assert np.isfinite(found.deviation).all()


def test_pieces_have_units_of_their_own():
    measures = {1: measures_of([4.0, 4.0, 8.0, 8.0, 3.0])}
    piece = np.array([0, 0, 1, 1, -1])
    depths = find_standing_depths(measures, piece, FOCAL, sizes={}, largest_piece=0)[1]
    assert [depth.frames for depth in depths] == [(0, 1), (2, 3)]
    np.testing.assert_allclose(depths[1].inverse_depth, 1 / 8, rtol=1e-6)
    sized = find_standing_depths(measures, piece, FOCAL, sizes={1: 3.2}, largest_piece=0)[1]
    assert [depth.scale_from for depth in sized] == ["size", "contact"]
    np.testing.assert_allclose(sized[1].inverse_depth, 1 / 8, rtol=1e-6)


@cache
def film():
    return walkers_film(bodies_path(COUNT), 180, 240)


@cache
def street():
    """Return the reconstruction of the film of walkers, with given labels and poses."""
    return tisfm.reconstruct(
        list(film().frames),
        camera=film().camera,
        settings=tisfm.Settings.preset("fast", motion="objects"),
        labels=film().labels,
        poses=film().poses,
    )


def test_walkers_are_not_fused():
    views = street()._views(None)
    for frame, view in zip(views.frames, views, strict=True):
        is_walker = film().labels[frame] > 0
        assert np.isfinite(street().inverse_depth_std(frame)[is_walker]).all()
        assert not np.isfinite(view.inverse_depth_std[is_walker]).any()
    assert len(street().points().positions) > 1000


@pytest.mark.parametrize("number", [1, 2])
def test_walkers_stand_where_they_walk(number):
    walker = next(obj for obj in street().objects if obj.id == number)
    assert walker.scale_from == "contact"
    assert walker.message.endswith("its depth is that of the place where it stands")
    errors, significances = [], []
    for frame in walker.frames:
        pixels = film().labels[frame] == number
        depth, deviation = street().depth(frame)[pixels], street().inverse_depth_std(frame)[pixels]
        assert np.isfinite(depth).all() and np.ptp(depth) == 0
        errors.append(np.median(depth / film().depth[frame][pixels]) - 1)
        significances.append(errors[-1] / (deviation[0] * depth[0]))
    assert len(errors) == COUNT and np.median(np.abs(errors)) < 0.1
    assert np.median(np.abs(significances)) < 2
