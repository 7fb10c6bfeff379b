"""Options of scenes: each changes the pair; sizes; what is impossible is said."""

import math

import numpy as np
import pytest

from tests.scenes.small import PAINT, TURNING, small_scene
from tisfm.camera import Camera
from tisfm.scenes import Box, Patch, Plane, Scene, Texture, rigid_motion, static_scene, two_blocks


def test_the_same_call_gives_the_same_pair():
    first, second = two_blocks(41, 53, seed=3), two_blocks(41, 53, seed=3)
    for name in ("frame0", "frame1", "depth", "flow", "tau", "omega", "labels", "visible"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_bands_do_not_show(monkeypatch):
    whole = two_blocks(29, 37)
    monkeypatch.setattr("tisfm.scenes.render.CHUNK", 1)
    rows = two_blocks(29, 37)
    # The matrix product may round otherwise at another length.
    assert np.abs(whole.frame0.astype(int) - rows.frame0).max() <= 1
    np.testing.assert_allclose(whole.flow, rows.flow, atol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"focal": 90.0},
        {"camera_motion": (0, 0.03, 0, 0, 0, 0)},
        {"block_motions": [[0.01, 0, 0, 0, 0, 0.01], [0, 0, 0, 0, 0.02, 0]]},
        {"samples": 2},
    ],
)
def test_every_option_changes_the_pair(change):
    usual, other = two_blocks(48, 64), two_blocks(48, 64, **change)
    assert (usual.frame1 != other.frame1).any()


def test_detail_changes_both_ready_scenes():
    for make in (two_blocks, lambda *size, **options: static_scene("forward", *size, **options)):
        usual, other = (make(24, 32, focal=640.0, detail=detail) for detail in (0, 1))
        assert (usual.frame0 != other.frame0).any() and (usual.frame1 != other.frame1).any()
        np.testing.assert_array_equal(usual.flow, other.flow)


def test_block_motions_add_to_the_camera_motion():
    own = np.array([[0.01, 0, 0, 0, 0, 0.01], [0, 0, 0, 0, 0.02, 0]])
    camera_motion = np.array(TURNING)
    pair = two_blocks(24, 32, camera_motion=camera_motion, block_motions=own)
    expected = [-camera_motion, -camera_motion, own[0] - camera_motion, own[1] - camera_motion]
    np.testing.assert_allclose(pair.motions, expected)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (13, 1), (37, 53), (54, 96)])
def test_any_size(size):
    pair = static_scene("forward+rotation", *size)
    assert pair.frame0.shape == pair.frame1.shape == pair.depth.shape == pair.labels.shape == size
    assert pair.flow.shape == (*size, 2) and pair.tau.shape == pair.omega.shape == (3, *size)
    assert pair.camera.focal == size[1]
    assert np.isfinite(pair.flow).all() and (pair.depth > 0).all()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: two_blocks(0, 10), "height is 0: expected a positive whole number"),
        (lambda: two_blocks(10, 12.5), "width is 12.5"),
        (lambda: two_blocks(10, 12, focal=-3.0), "focal is -3"),
        (lambda: two_blocks(10, 12, camera_motion=(1, 2, 3)), r"camera_motion has shape \(3,\)"),
        (lambda: two_blocks(10, 12, block_motions=np.zeros((3, 6))), r"block_motions .*\(3, 6\)"),
        (lambda: two_blocks(10, 12, samples=0), "samples is 0"),
        (lambda: two_blocks(10, 12, dtype="int8"), "dtype is 'int8': expected 'uint8'"),
        (lambda: two_blocks(10, 12, detail=-1), "detail is -1: expected a non-negative whole"),
        (lambda: two_blocks(10, 12, detail=1.5), "detail is 1.5"),
        (lambda: static_scene("orbit"), "kind is 'orbit': expected one of 'sideways'"),
        (lambda: rigid_motion((0, 0, 0, 0, 0, math.nan)), "motion .*nan.*finite"),
        (lambda: Texture(wavelength=0.0), "wavelength is 0.0"),
        (lambda: Patch(center=(0, math.nan), size=(1, 1), grey=9), "center is .*finite"),
        (lambda: Patch(center=(0, 0), size=(1, 0), grey=9), "size is .*positive"),
        (lambda: Patch(center=(0, 0), size=(1, 1), grey=256), "grey is 256"),
        (lambda: Texture(wavelength=1.0, octaves=0), "octaves is 0"),
        (lambda: Texture(wavelength=1.0, mean=200, contrast=60), "200 ± 60"),
        (lambda: Texture(wavelength=1.0, seed=-1), "seed is -1"),
        (lambda: Plane(texture=PAINT, normal=(0, 0, 0)), "normal is"),
        (lambda: Plane(texture=PAINT, point=(0, 1)), r"point has shape \(2,\)"),
        (lambda: Box(texture=PAINT, center=(0, 0, 1), size=(1, -1, 1)), "size is .*positive"),
        (
            lambda: Box(texture=PAINT, center=(0, 0, 1), size=(1, 1, 1), axes=-np.eye(3)),
            "expected a rotation",
        ),
        (
            lambda: Box(texture=PAINT, center=(0, 0, 1), size=(1, 1, 1), axes=np.eye(2)),
            r"axes has shape \(2, 2\)",
        ),
        (lambda: small_scene(width=-4), "width is -4"),
        (lambda: Scene(objects=[], camera=Camera(), height=2, width=2), "objects is empty"),
        (
            lambda: Scene(
                objects=[Plane(texture=PAINT, point=(0, 0, -1))], camera=Camera(), height=2, width=2
            ).render(),
            "background Plane",
        ),
    ],
)
def test_errors_name_the_argument(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_objects_must_be_shapes():
    with pytest.raises(TypeError, match=r"objects\[1\] is a str: expected a Plane or a Box"):
        Scene(objects=[Plane(texture=PAINT), "box"], camera=Camera(), height=2, width=2)
