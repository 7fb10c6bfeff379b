"""The room: its truth, its bare walls, its noise and its options."""

import cv2
import numpy as np
import pytest

from tests.rendered import room
from tests.scenes.small import rays_of, series_exponential
from tests.scenes.test_pictures import warped_back

PLANES = {0: "far wall", 1: "right wall", 4: "ceiling", 5: "floor"}  # that the camera sees
ARRAYS = ("frame0", "frame1", "depth", "flow", "tau", "omega", "labels", "visible", "textured")


@pytest.fixture(scope="module")
def clean():
    return room(noise=0)


def test_true_flow_maps_frame1_onto_frame0(clean):
    def mismatch(flow, where):
        return np.abs(warped_back(clean, flow) - clean.frame0)[where & clean.visible].mean()

    assert mismatch(clean.flow, True) < 1.0
    assert mismatch(clean.flow, ~clean.textured) < 0.5
    for wrong in (0 * clean.flow, -clean.flow, clean.flow[..., ::-1], 0.8 * clean.flow):
        assert mismatch(wrong, clean.textured) > 3 * mismatch(clean.flow, clean.textured)


def test_flow_is_the_projection_of_the_moved_point(clean):
    x, y = rays_of(clean)
    assert (clean.motions == clean.motions[0]).all()
    R, t = series_exponential(clean.motions[0])
    P0 = clean.depth * np.stack([x, y, np.ones_like(x)])
    P1 = np.tensordot(R, P0, 1) + t[:, None, None]
    expected = clean.camera.focal * (P1[:2] / P1[2] - P0[:2] / P0[2])
    np.testing.assert_allclose(np.moveaxis(clean.flow, -1, 0), expected, atol=1e-9)
    length = np.linalg.norm(clean.flow, axis=-1)
    assert 6 < length.min() < length.max() < 26  # half of that at 480×640


@pytest.mark.parametrize("label", PLANES, ids=PLANES.values())
def test_walls_and_floor_are_planes(clean, label):
    on = clean.labels == label
    assert on.sum() > 3000
    x, y = (rays[on] for rays in rays_of(clean))
    basis = np.column_stack([x, y, np.ones_like(x)])
    plane, *_ = np.linalg.lstsq(basis, clean.inverse_depth[on], rcond=None)
    # The rays' condition number is about 20.
    np.testing.assert_allclose(basis @ plane, clean.inverse_depth[on], rtol=1e-12)
    assert np.hypot(*plane[:2]) > 0.2 * np.linalg.norm(plane)  # nothing faces the camera


def test_most_of_the_room_is_bare(clean):
    assert 0.5 < (~clean.textured).mean() < 0.8
    assert (clean.textured == (clean.labels >= 5)).all()
    assert clean.visible.mean() > 0.85 and not clean.visible.all()
    bare = cv2.erode((~clean.textured).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    for axis in (0, 1):
        step = np.abs(np.diff(clean.frame0.astype(float), axis=axis, append=0))
        # Walls meet at steps of grey: those are few.
        assert np.percentile(step[bare & (np.arange(320) < 318)], 95) <= 1
        assert step[clean.textured].mean() > 3 * step[bare].mean()


def test_tiles_look_alike_but_not_the_same(clean):
    floor = clean.labels == 5
    inside = cv2.erode(floor.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    frame = clean.frame0.astype(np.float32)
    joints = (frame < cv2.blur(frame, (9, 9)) - 8) & inside
    assert 0.02 < joints[inside].mean() < 0.3
    middle = frame[inside & ~cv2.dilate(joints.astype(np.uint8), np.ones((3, 3))).astype(bool)]
    assert 2 < middle.std() < 12


def test_noise_has_the_given_deviation():
    # Float frames are not rounded, so their difference is the noise alone.
    noisy, quiet = (room(90, 120, noise=noise, dtype="float32") for noise in (3.0, 0))
    dark = (quiet.frame0 < 240) & (quiet.frame1 < 240)
    off0, off1 = ((getattr(noisy, k) - getattr(quiet, k))[dark] for k in ("frame0", "frame1"))
    for off in (off0, off1):
        assert off.std() == pytest.approx(3, rel=0.05) and abs(off.mean()) < 0.15
    assert abs(np.corrcoef(off0, off1)[0, 1]) < 0.05
    np.testing.assert_array_equal(noisy.flow, quiet.flow)


def test_blur_is_a_gaussian():
    sharp, soft = (room(90, 120, noise=0, blur=blur, dtype="float32") for blur in (0, 1.5))
    expected = cv2.GaussianBlur(sharp.frame0, (0, 0), 1.5, borderType=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(soft.frame0, expected, atol=1e-3)
    assert soft.frame1.std() < sharp.frame1.std()


@pytest.mark.parametrize("seed", [0, 7])
def test_the_same_seed_gives_the_same_pair(seed):
    from tisfm.scenes import room  # rendered anew

    first, second = room(41, 53, seed=seed), room(41, 53, seed=seed)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    other = room(41, 53, seed=seed + 1)
    assert (first.frame0 != other.frame0).mean() > 0.5
    np.testing.assert_array_equal(first.depth, other.depth)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"focal": 90.0},
        {"camera_motion": (0, 0.03, 0, 0, 0, 0)},
        {"noise": 0.0},
        {"blur": 1.0},
        {"samples": 2},
    ],
)
def test_every_option_changes_the_pair(change):
    usual, other = room(48, 64), room(48, 64, **change)
    assert (usual.frame1 != other.frame1).any()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (13, 1), (37, 53), (54, 97)])
def test_any_size(size):
    pair = room(*size)
    assert all(getattr(pair, name).shape == size for name in ("frame0", "frame1", "depth"))
    assert pair.frame0.dtype == pair.frame1.dtype == np.uint8
    assert pair.camera.focal == pytest.approx(0.6 * size[1])
    assert np.isfinite(pair.flow).all() and (pair.depth > 0).all()


def test_the_camera_may_look_anywhere():
    turned = room(30, 40, camera_motion=(0, 0, 0, 0.3, 2.5, 0), noise=0)
    assert np.isfinite(turned.frame1).all() and turned.frame1.min() > 30


def test_twice_the_size_is_the_same_picture(clean):
    fine = room(480, 640, noise=0, samples=1)
    halved = fine.frame0.reshape(240, 2, 320, 2).mean(axis=(1, 3))
    difference = np.abs(halved - clean.frame0)
    # It has an octave more of detail, which counts for little.
    assert difference.mean() < 1.5
    flow = fine.flow.reshape(240, 2, 320, 2, 2).mean(axis=(1, 3))
    labels = fine.labels.reshape(240, 2, 320, 2)
    same = (labels == clean.labels[:, None, :, None]).all(axis=(1, 3))
    assert same.mean() > 0.95
    same &= clean.labels <= 5  # boxes have edges between their faces
    np.testing.assert_allclose(flow[same], 2 * clean.flow[same], atol=0.02)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"height": 0}, "height is 0: expected a positive whole number"),
        ({"width": 12.5}, "width is 12.5"),
        ({"focal": -3.0}, "focal is -3"),
        ({"camera_motion": (1, 2, 3)}, r"camera_motion has shape \(3,\)"),
        ({"noise": -0.5}, "noise is -0.5: expected a number of at least 0"),
        ({"blur": float("nan")}, "blur is nan: expected a number of at least 0"),
        ({"blur": float("inf")}, "blur is inf"),
        ({"samples": 0}, "samples is 0"),
        ({"seed": -1}, "seed is -1: expected a non-negative whole number"),
        ({"dtype": "int8"}, "dtype is 'int8': expected 'uint8'"),
    ],
)
def test_errors_name_the_argument(change, words):
    with pytest.raises(ValueError, match=words):
        room(**{"height": 10, "width": 12, **change})
