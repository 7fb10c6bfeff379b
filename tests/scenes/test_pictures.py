"""Pictures of scenes: against the truth, at any size, with any detail, and bare parts."""

import cv2
import numpy as np
import pytest

from tests.scenes.small import PAINT, rays_of, small_scene
from tisfm.camera import Camera
from tisfm.scenes import STATIC_KINDS, Box, Patch, Plane, Scene, Texture, bare_patches, two_blocks


def warped_back(pair, flow):
    y, x = np.mgrid[: flow.shape[0], : flow.shape[1]]
    columns, rows = (x + flow[..., 0]).astype(np.float32), (y + flow[..., 1]).astype(np.float32)
    frame1 = pair.frame1.astype(np.float32)
    return cv2.remap(frame1, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize("name", ["two_blocks", *STATIC_KINDS])
def test_true_flow_maps_frame1_onto_frame0(pairs, name):
    pair = pairs[name]

    def mismatch(flow):
        return np.abs(warped_back(pair, flow) - pair.frame0)[pair.visible].mean()

    assert mismatch(pair.flow) < 1.0
    for wrong in (0 * pair.flow, -pair.flow, pair.flow[..., ::-1], 0.8 * pair.flow):
        assert mismatch(wrong) > 1.5 * mismatch(pair.flow)
    assert mismatch(-pair.flow) > 8


@pytest.mark.parametrize("name", ["two_blocks", *STATIC_KINDS])
def test_pictures_look_natural(pairs, name):
    pair = pairs[name]
    for frame in (pair.frame0, pair.frame1):
        assert frame.dtype == np.uint8 and frame.shape == (240, 320)
        assert frame.min() >= 30 and frame.max() <= 230 and 30 < frame.std() < 42
    assert set(np.unique(pair.labels)) == set(range(len(pair.motions)))
    assert all((pair.labels == label).sum() > 1500 for label in range(len(pair.motions)))
    length = np.linalg.norm(pair.flow, axis=-1)
    assert 1 < length.mean() < 4 and length.max() < 9
    assert pair.visible.mean() > 0.9 and not pair.visible.all()


def test_blocks_move_on_their_own(pairs):
    motions = pairs["two_blocks"].motions
    assert (motions[0] == motions[1]).all() and len(np.unique(motions, axis=0)) == 3
    assert (motions[:, 3:] == 0).all()
    left, toward = motions[2:, 0] - motions[0, 0], motions[2:, 2] - motions[0, 2]
    assert (left < 0).all() and toward[0] > 0 > toward[1]
    length = np.linalg.norm(pairs["two_blocks"].flow, axis=-1)
    assert length.min() > 1 and length.max() < 5


def test_whole_pixel_motion_shifts_the_frame():
    plane = Plane(texture=PAINT, motion=(0.5, 0.25, 0, 0, 0, 0))
    scene = Scene(objects=[plane], camera=Camera(focal=80.0), height=31, width=47)
    pair = scene.render(dtype="float32")
    np.testing.assert_allclose(pair.flow, np.broadcast_to((4, 2), (31, 47, 2)), atol=1e-12)
    # float32 coefficients of the noise, times its contrast
    np.testing.assert_allclose(pair.frame1[2:, 4:], pair.frame0[:-2, :-4], atol=1e-3)
    assert pair.frame0.std() > 20


def test_twice_the_size_is_the_same_picture(pairs):
    coarse, fine = pairs["two_blocks"], two_blocks(480, 640, detail=0, samples=1)
    halved = fine.frame0.reshape(240, 2, 320, 2).mean(axis=(1, 3))
    difference = np.abs(halved - coarse.frame0)
    assert difference.mean() < 0.6 and np.quantile(difference, 0.99) < 5
    np.testing.assert_allclose(fine.motions, coarse.motions)
    labels = fine.labels.reshape(240, 2, 320, 2)
    same = (labels == coarse.labels[:, None, :, None]).all(axis=(1, 3))
    assert same.mean() > 0.98
    # A pixel centre falls between four of the finer ones.
    flow = fine.flow.reshape(240, 2, 320, 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(flow[same], 2 * coarse.flow[same], atol=0.02)


@pytest.mark.parametrize(
    ("width", "octaves"), [(1, 0), (64, 0), (320, 0), (400, 0), (640, 1), (960, 2), (1920, 3)]
)
def test_detail_follows_the_width(width, octaves):
    usual = two_blocks(9, width, samples=1, dtype="float32")
    same = two_blocks(9, width, samples=1, dtype="float32", detail=octaves)
    assert (usual.frame0 == same.frame0).all() and (usual.frame1 == same.frame1).all()


def test_larger_pictures_are_not_smoother(pairs):
    def roughness(pair):  # what a blur of 5 px removes from the blocks, median, grey levels
        frame = pair.frame0.astype(np.float32)
        inside = cv2.erode((pair.labels >= 2).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        return np.median(np.abs(frame - cv2.blur(frame, (5, 5)))[inside])

    usual = roughness(pairs["two_blocks"])
    assert 0.5 * usual < roughness(two_blocks(240, 1280, samples=1)) < usual
    assert roughness(two_blocks(240, 1280, samples=1, detail=0)) < 0.15 * usual


def test_detail_adds_short_waves_only():
    def frame(detail):
        plane = Plane(texture=Texture(wavelength=0.1, detail=detail))
        camera = Camera(focal=1600.0)  # waves of 16 px, then of 8 and 4 px
        return Scene(objects=[plane], camera=camera, height=160, width=160).render().frame0

    plain, one, two = (frame(detail).astype(np.float32) for detail in (0, 1, 2))
    assert np.abs(cv2.GaussianBlur(two - plain, (0, 0), 6)).max() < 5 < np.abs(two - plain).max()
    spectrum = np.abs(np.fft.fft2(two - one)) ** 2
    cycles = np.hypot(*np.meshgrid(np.fft.fftfreq(160), np.fft.fftfreq(160)))
    assert spectrum[(cycles > 0.17) & (cycles < 0.34)].sum() > 0.6 * spectrum.sum()


def test_detail_too_fine_for_the_pixels_changes_nothing():
    coarse, detailed = (two_blocks(45, 60, detail=detail, dtype="float32") for detail in (0, 3))
    assert (coarse.frame0 == detailed.frame0).all()


def test_more_samples_converge():
    finest = two_blocks(60, 80, samples=12, dtype="float32").frame0

    def gap(samples):
        frame = two_blocks(60, 80, samples=samples, dtype="float32").frame0
        return np.sqrt(np.square(frame - finest).mean())

    gaps = [gap(samples) for samples in (1, 3, 6)]
    assert gaps[0] > 2 * gaps[1] > 3 * gaps[2] > 0


def test_far_texture_fades_to_grey_instead_of_aliasing():
    near, far = (
        Scene(
            objects=[Plane(texture=PAINT, point=(0, 0, depth))],
            camera=Camera(focal=320.0),
            height=40,
            width=40,
        ).render(dtype="float32")
        for depth in (8, 400)
    )
    assert near.frame0.std() > 20
    # The longest of the five waves, 1.6, is not two footprints of 400/320 long.
    assert (far.frame0 == np.float32(PAINT.mean)).all()


def test_texture_fades_where_a_surface_is_seen_edge_on():
    def row(tilt):
        plane = Plane(texture=PAINT, point=(0, 0, 8), normal=(0, 1, -tilt))
        scene = Scene(objects=[plane], camera=Camera(focal=320.0), height=1, width=99)
        return scene.render(samples=1, dtype="float32")

    # The middle row meets either plane at depth 8; pixels cover 1/40 and 1/40 · 100 of it.
    assert (row(1e-4).depth == 8).all() and row(1.0).frame0.std() > 20
    assert (row(1e-4).frame0 == np.float32(PAINT.mean)).all()


def test_float_frames_are_the_unrounded_ones():
    exact, rounded = (two_blocks(31, 43, dtype=dtype) for dtype in ("float32", "uint8"))
    assert exact.frame0.dtype == np.float32
    assert (np.rint(exact.frame0) == rounded.frame0).all()
    assert (exact.frame0 != rounded.frame0).any()


def test_a_face_differs_from_the_others_in_shade():
    flat = Texture(wavelength=0.1, mean=100, contrast=0)
    scene = small_scene()
    box = Box(texture=flat, center=(0.3, 0.4, 4), size=(1, 1.2, 0.8), axes=scene.objects[2].axes)
    frame = Scene(
        objects=[Plane(texture=flat), box], camera=Camera(focal=40.0), height=33, width=45
    ).render(samples=1)
    greys = np.unique(frame.frame0[frame.labels == 1])
    assert len(greys) == 2 and (frame.frame0[frame.labels == 0] == 100).all()


def test_bare_parts_are_of_one_grey_level_and_the_rest_is_not():
    pair = bare_patches(samples=1)
    bare = ~pair.textured
    assert 0.15 < bare.mean() < 0.35
    for label, greys in ((0, {105, 128}), (1, {172})):  # the block's front is shaded by 0.98
        assert set(np.unique(pair.frame0[bare & (pair.labels == label)])) == greys
        texture = pair.frame0[pair.textured & (pair.labels == label)]
        assert texture.std() > 10


def test_a_patch_covers_its_rectangle_on_planes_and_faces():
    patch = Patch(center=(0.5, -0.25), size=(1.0, 0.5), grey=200)
    paint = Texture(wavelength=0.1, mean=100, contrast=50, patches=(patch,))
    camera = Camera(focal=40.0)
    plane = Plane(texture=paint, point=(0, 0, 4), normal=(0, 0, 1))
    box = Box(texture=paint, center=(0, 0, 4.05), size=(9, 9, 0.1))
    for item in (plane, box):
        pair = Scene(objects=[item], camera=camera, height=31, width=41).render(samples=1)
        x, y = (ray * pair.depth for ray in rays_of(pair))
        expected = (x >= 0) & (x <= 1) & (y >= -0.5) & (y <= 0)
        np.testing.assert_array_equal(~pair.textured, expected)
        assert set(np.unique(pair.frame0[expected])) == {200 if item is plane else 196}


def test_a_texture_without_contrast_is_bare_everywhere():
    flat = Plane(texture=Texture(wavelength=0.1, contrast=0))
    pair = Scene(objects=[flat], camera=Camera(), height=8, width=9).render()
    assert not pair.textured.any()
