"""The map of occlusion: against rendered truth, and what must be marked or not whatever else."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.pairwise import pairwise
from tests.rendered import static_scene, two_blocks
from tisfm.metrics import endpoint_error_map
from tisfm.scenes import Scene
from tisfm.scenes.geometry import Box, Plane
from tisfm.scenes.texture import Texture
from tisfm.visibility.occlusion import BORDER_MARGIN, leaves_image, occlusion

H, W = 120, 160


def passing_block(shift, *, behind=0.0):
    """A wall, and a block before it that moves by `shift` px to the right."""
    depth, focal = 4.0, float(W)

    def paint(seed, mean):
        return Texture(wavelength=4 * depth / W, detail=0, mean=mean, contrast=45, seed=seed)

    def motion(pixels):
        return (pixels * depth / focal, 0, 0, 0, 0, 0)

    wall = Plane(
        texture=paint(0, 100), point=(0, 0, depth), normal=(0, 0, -1), motion=motion(behind)
    )
    block = Box(
        texture=paint(1, 150), center=(0, 0, depth), size=(1.4, 1.4, 0.1), motion=motion(shift)
    )
    scene = Scene(objects=[wall, block], camera=tisfm.Camera(focal=focal), height=H, width=W)
    return scene.render()


def precision_and_recall(found, truth):
    hits = (found & truth).sum()
    return hits / found.sum(), hits / truth.sum()


@pairwise(preset=["fast", "balanced", "accurate"], shift=[3, -5], short=True)
def test_a_block_that_passes_a_wall_at_rest(preset, shift):
    pair = passing_block(shift)
    settings = tisfm.Settings.preset(preset)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
    precision, recall = precision_and_recall(result.occlusion, ~pair.visible)
    assert precision > 0.8
    assert recall > (0.6 if preset == "fast" else 0.7)  # it ends at half the resolution


def test_true_flow_marks_true_occlusion():
    """The block moves by whole pixels, so the strip that it hides is known to the pixel."""
    pair = passing_block(4)
    grey = [frame.astype(np.float32) for frame in (pair.frame0, pair.frame1)]
    flow = np.ascontiguousarray(np.moveaxis(pair.flow, -1, 0), dtype=np.float32)
    found = occlusion(*grey, flow, tisfm.Settings())
    precision, recall = precision_and_recall(found, ~pair.visible)
    assert precision > 0.9
    assert recall > 0.9


def test_both_blocks_of_the_demo():
    pair = two_blocks(240, 320, seed=0)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera)
    precision, recall = precision_and_recall(result.occlusion, ~pair.visible)
    assert precision > 0.6
    assert recall > 0.6


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_change_of_illumination_is_no_occlusion(factor):
    """A fifth of the brightness, under which the flow itself is off by 0.1 px."""
    pair = passing_block(4)
    frames = pair.frame0.astype(np.float32), factor * pair.frame1.astype(np.float32)
    result = tisfm.interpret(*frames, camera=pair.camera)
    inner = (slice(1, -1), slice(1, -1))  # the border drifts, out of the image here and there
    precision, recall = precision_and_recall(result.occlusion[inner], ~pair.visible[inner])
    assert precision > 0.5
    assert recall > 0.7
    assert result.occlusion[inner].mean() < 0.03


@pytest.mark.parametrize("scale", [0.85, 0.95, 1.1])
def test_a_change_of_scale_hides_nothing(scale):
    """A camera that backs off brings several pixels to one, of the same surface."""
    rng = np.random.default_rng(0)
    frame = cv2.GaussianBlur(rng.uniform(0, 255, (H, W)).astype(np.float32), (0, 0), 2)
    y, x = np.mgrid[:H, :W].astype(np.float32)
    middle = np.array([(W - 1) / 2, (H - 1) / 2], np.float32)
    flow = np.stack([(scale - 1) * (x - middle[0]), (scale - 1) * (y - middle[1])])
    matrix = np.array([[scale, 0, (1 - scale) * middle[0]], [0, scale, (1 - scale) * middle[1]]])
    moved = cv2.warpAffine(frame, matrix, (W, H), borderMode=cv2.BORDER_REFLECT_101)
    noisy = moved + rng.normal(0, 2, (H, W)).astype(np.float32)
    found = occlusion(frame, noisy, flow, tisfm.Settings())
    assert not (found & ~leaves_image(flow)).any()


@pytest.mark.parametrize(("axis", "side"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_the_image_ends_a_margin_beyond_its_last_pixels(axis, side):
    """At MARGIN px from the centres of the border's pixels, on every side."""
    height, width = 7, 9
    place = np.indices((height, width), np.float32)[::-1]  # x, y
    last = (width - 1, height - 1)[axis]
    for beyond in (-0.01, 0.01):
        end = last + BORDER_MARGIN + beyond if side > 0 else -BORDER_MARGIN - beyond
        flow = np.zeros((2, height, width), np.float32)
        flow[axis] = end - place[axis]
        assert (leaves_image(flow) == (beyond > 0)).all()


@pytest.mark.parametrize("preset", ["paper", "balanced"])
def test_pixels_that_leave_the_image_are_occluded(preset):
    pair = static_scene("sideways", H, W)
    settings = tisfm.Settings.preset(preset)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
    leaves = leaves_image(np.moveaxis(result.flow, -1, 0))
    assert leaves.any() and not leaves.all()
    assert result.occlusion[leaves].all()


def test_still_frames_have_no_occlusion():
    pair = two_blocks(H, W)
    uniform = np.full((H, W), 90, np.uint8)
    for frames in ((pair.frame0, pair.frame0), (uniform, uniform + 20)):
        assert not tisfm.interpret(*frames).occlusion.any()


def test_flow_that_is_no_number_is_marked_and_harms_no_other_pixel():
    pair = passing_block(4)
    grey = [frame.astype(np.float32) for frame in (pair.frame0, pair.frame1)]
    flow = np.ascontiguousarray(np.moveaxis(pair.flow, -1, 0), dtype=np.float32)
    before = occlusion(*grey, flow, tisfm.Settings())
    flow[0, 5, 5], flow[1, 5, 30], flow[0, 5, 60] = np.nan, np.inf, -1e30
    found = occlusion(*grey, flow, tisfm.Settings())
    assert found[5, [5, 30, 60]].all()
    far = np.ones((H, W), bool)
    far[:10] = False
    np.testing.assert_array_equal(found[far], before[far])


def test_a_flow_without_any_number_is_occluded_everywhere():
    grey = np.zeros((8, 9), np.float32)
    flow = np.full((2, 8, 9), np.nan, np.float32)
    assert occlusion(grey, grey, flow, tisfm.Settings()).all()


def test_pixels_that_leave_the_image_need_no_backward_flow():
    pair = passing_block(4)
    grey = [frame.astype(np.float32) for frame in (pair.frame0, pair.frame1)]
    flow = np.ascontiguousarray(np.moveaxis(pair.flow, -1, 0), dtype=np.float32)
    flow[0, :, -3:] = 5
    leaves = leaves_image(flow)
    assert leaves.any()
    settings = tisfm.Settings()
    found = occlusion(*grey, flow, settings, is_leaving=leaves)
    np.testing.assert_array_equal(found, occlusion(*grey, flow, settings))
    assert occlusion(*grey, flow, settings, is_leaving=~leaves)[~leaves].all()


@pytest.mark.parametrize("size", [(16, 40000), (40000, 16)])
def test_sides_beyond_the_limits_of_16_bits(size):
    """Noise that moves by whole pixels: what stays inside is seen."""
    frame = np.random.default_rng(0).uniform(0, 255, size).astype(np.float32)
    flow = np.zeros((2, *size), np.float32)
    along = 0 if size[1] > size[0] else 1
    flow[along] = 3
    moved = np.roll(frame, 3, axis=1 - along)
    found = occlusion(frame, moved, flow, tisfm.Settings())
    np.testing.assert_array_equal(found, leaves_image(flow))
    assert found.sum() == 3 * 16


def test_arguments_are_not_modified():
    pair = passing_block(4)
    grey = [frame.astype(np.float32) for frame in (pair.frame0, pair.frame1)]
    flow = np.ascontiguousarray(np.moveaxis(pair.flow, -1, 0), dtype=np.float32)
    flow[0, 3, 3] = np.nan
    copies = [array.copy() for array in (*grey, flow)]
    occlusion(*grey, flow, tisfm.Settings(presmoothing=0))
    for array, copy in zip((*grey, flow), copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("weights", [(1.0, 0.0), (0.0, 1.0)])
def test_either_constraint_alone_will_do(weights):
    pair = passing_block(4)
    grey = [frame.astype(np.float32) for frame in (pair.frame0, pair.frame1)]
    flow = np.ascontiguousarray(np.moveaxis(pair.flow, -1, 0), dtype=np.float32)
    settings = tisfm.Settings(brightness=weights[0], gradient=weights[1])
    precision, recall = precision_and_recall(occlusion(*grey, flow, settings), ~pair.visible)
    assert precision > 0.85
    assert recall > 0.85


def test_errors_are_larger_where_occluded_and_confidence_knows():
    pair = two_blocks(240, 320, seed=0)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera)
    error = endpoint_error_map(result.flow, pair.flow)
    assert error[result.occlusion].mean() > 3 * error[~result.occlusion].mean()
    assert not result.confidence[result.occlusion].any()


@pytest.mark.parametrize("extra", [0, 1])
def test_frames_of_a_coarser_level_tell_which_surface_is_seen(extra):
    """At odd sizes, too, where levels are not half as large: an exact flow leaves no residual."""
    from tisfm.motion.problems import pyramid_of
    from tisfm.visibility.occlusion import flow_residual, pyramid_occlusion

    pair = passing_block(4)
    grey = [
        np.pad(frame.astype(np.float32), ((0, extra), (0, extra)), mode="reflect")
        for frame in (pair.frame0, pair.frame1)
    ]
    flow = np.pad(pair.flow, ((0, extra), (0, extra), (0, 0)), mode="edge")
    flow = np.ascontiguousarray(np.moveaxis(flow, -1, 0), dtype=np.float32)
    hidden = np.pad(~pair.visible, ((0, extra), (0, extra)), mode="edge")
    settings = tisfm.Settings.preset("fast")
    pyramid = pyramid_of(*grey, pair.camera, settings)
    found = pyramid_occlusion(pyramid, flow, settings, level=1)
    precision, recall = precision_and_recall(found, hidden)
    assert precision > 0.8
    assert recall > 0.8
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (90, 190)).astype(np.float32), (0, 0), 3)
    frames = [np.ascontiguousarray(texture[: 80 + extra, k : k + 120 + extra]) for k in (20, 0)]
    pyramid = pyramid_of(*frames, pair.camera, settings)
    flow = np.zeros((2, *frames[0].shape), np.float32)
    flow[0] = 20
    levels = pyramid.frames0[1], pyramid.frames1[1]
    residual = flow_residual(*levels, flow, settings, factor=2)
    assert residual[10:-10, 10:-40].max() < 0.05 < residual[:, -15:].max()
