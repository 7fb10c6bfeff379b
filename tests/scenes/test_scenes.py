"""Synthetic scenes: the truth against brute force, the pictures against the truth."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tisfm.camera import Camera
from tisfm.scenes import (
    STATIC_KINDS,
    Box,
    Patch,
    Plane,
    Scene,
    Texture,
    bare_patches,
    rigid_motion,
    static_scene,
    two_blocks,
)

PAINT = Texture(wavelength=0.1)
TURNING = (0.05, -0.03, 0.12, 0.01, -0.02, 0.015)


@pytest.fixture(scope="module")
def pairs():
    made = {kind: static_scene(kind) for kind in STATIC_KINDS}
    made["two_blocks"] = two_blocks()
    return made


def twist_matrix(motion):
    T, omega = np.array(motion[:3]), np.array(motion[3:])
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = np.cross(np.eye(3), -omega).T
    matrix[:3, 3] = T
    np.testing.assert_allclose(matrix[:3, :3] @ T, np.cross(omega, T), atol=1e-12)
    return matrix


def series_exponential(motion):
    """exp of the 4×4 twist by its power series, at a 1024th and squared ten times."""
    small = twist_matrix(motion) / 1024
    total, term = np.eye(4), np.eye(4)
    for n in range(1, 12):
        term = term @ small / n
        total = total + term
    for _ in range(10):
        total = total @ total
    return total[:3, :3], total[:3, 3]


def rays_of(pair):
    height, width = pair.depth.shape
    cx, cy = pair.camera.center_for(height, width)
    y, x = np.mgrid[:height, :width]
    return (x - cx) / pair.camera.focal, (y - cy) / pair.camera.focal


def small_scene(motion=TURNING, height=33, width=45, **changes):
    c, s = math.cos(0.5), math.sin(0.5)
    objects = [
        Plane(texture=PAINT, motion=motion),
        Plane(texture=PAINT, point=(0, 1.5, 0), normal=(0.1, -2, -0.3), motion=motion),
        Box(
            texture=PAINT,
            center=(-0.4, 0.5, 4),
            size=(1, 1.2, 0.8),
            axes=[[c, 0, s], [0, 1, 0], [-s, 0, c]],
            motion=tuple(0.7 * value for value in motion),
        ),
    ]
    camera = Camera(focal=40.0, center=(20.3, 17.1))
    return Scene(objects=objects, camera=camera, height=height, width=width, **changes)


# --- rigid motion ---------------------------------------------------------------------------

components = st.floats(-2, 2)


@given(motion=st.tuples(*[components] * 6))
def test_rigid_motion_is_the_exponential_of_the_twist(motion):
    R, t = rigid_motion(motion)
    expected_R, expected_t = series_exponential(motion)
    # Ten squarings lose about 2^10 roundings.
    np.testing.assert_allclose(R, expected_R, atol=1e-11)
    np.testing.assert_allclose(t, expected_t, atol=1e-11)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)


@pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-9, 1e-4, 0.00999, 0.01001, 1.0, math.pi, 6.0])
def test_rigid_motion_at_small_and_large_angles(angle):
    T, axis = np.array([0.3, -1.0, 0.7]), np.array([2, -1, 2]) / 3
    R, t = rigid_motion([*T, *(angle * axis)])
    along = (axis @ T) * axis
    across = T - along
    # The arc of a circle: V T rotates and shortens only what is across the axis.
    chord = math.sin(angle) / angle if angle > 1e-8 else 1 - angle**2 / 6
    bulge = 2 * math.sin(angle / 2) ** 2 / angle if angle > 1e-8 else angle / 2
    expected = along + chord * across + bulge * np.cross(axis, across)
    np.testing.assert_allclose(t, expected, rtol=0, atol=1e-14)
    assert np.trace(R) == pytest.approx(1 + 2 * math.cos(angle), abs=1e-14)


def test_translation_alone_is_exact():
    R, t = rigid_motion((0.1, 0.2, 0.3, 0, 0, 0))
    assert (np.eye(3) == R).all() and (t == (0.1, 0.2, 0.3)).all()


# --- truth ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["two_blocks", *STATIC_KINDS])
def test_flow_is_the_projection_of_the_moved_point(pairs, name):
    pair = pairs[name]
    x, y = rays_of(pair)
    for label, motion in enumerate(pair.motions):
        on = pair.labels == label
        R, t = series_exponential(motion)
        P0 = pair.depth[on] * np.stack([x[on], y[on], np.ones(on.sum())])
        P1 = R @ P0 + t[:, None]
        expected = pair.camera.focal * (P1[:2] / P1[2] - P0[:2] / P0[2])
        np.testing.assert_allclose(pair.flow[on].T, expected, atol=1e-9)
        T, omega = motion[:3], motion[3:]
        np.testing.assert_allclose(pair.tau[:, on], T[:, None] / pair.depth[on], rtol=1e-12)
        assert (pair.omega[:, on] == omega[:, None]).all()
    np.testing.assert_allclose(pair.inverse_depth * pair.depth, 1)


def test_depth_is_that_of_the_nearest_surface():
    scene = small_scene()
    pair = scene.render(samples=1)
    _, floor, box = scene.objects
    x, y = rays_of(pair)
    P = pair.depth * np.stack([x, y, np.ones_like(x)])
    assert (pair.depth[pair.labels == 0] == 10).all()
    height_over_floor = np.tensordot(floor.normal, P, 1) - floor.normal @ floor.point
    np.testing.assert_allclose(height_over_floor[pair.labels == 1], 0, atol=1e-12)
    assert (height_over_floor > -1e-12).all()

    def depth_in_box(points):  # how far inside, relative; negative outside
        q = np.tensordot(box.axes.T, points - box.center.reshape(3, 1, 1), 1)
        return 1 - np.abs(2 * q / box.size.reshape(3, 1, 1)).max(axis=0)

    np.testing.assert_allclose(depth_in_box(P)[pair.labels == 2], 0, atol=1e-12)
    for fraction in np.linspace(0.01, 0.999, 60):
        assert (depth_in_box(P * fraction) < 0).all(), "a ray passes through the box"
    assert {0, 1, 2} == set(np.unique(pair.labels))


def test_flow_tends_to_the_instantaneous_flow_at_second_order():
    gaps = []
    for scale in (1, 1 / 2, 1 / 4, 1 / 8):
        pair = small_scene(motion=tuple(scale * value for value in TURNING)).render(samples=1)
        x, y = rays_of(pair)
        one, zero = np.ones_like(x), np.zeros_like(x)
        G = np.array([[one, zero, -x, -x * y, 1 + x**2, -y], [zero, one, -y, -1 - y**2, x * y, x]])
        rho = pair.camera.focal * np.concatenate([pair.tau, pair.omega])
        first_order = np.einsum("ckij,kij->ijc", G, rho)
        gaps.append(np.abs(pair.flow - first_order).max())
    orders = np.log2(np.divide(gaps[:-1], gaps[1:]))
    assert np.abs(orders - 2).max() < 0.1, gaps


def test_a_camera_moving_right_makes_everything_move_left(pairs):
    flow = pairs["sideways"].flow
    assert (flow[..., 0] < 0).all()
    np.testing.assert_allclose(flow[..., 1], 0, atol=1e-12)


def test_a_camera_moving_forward_sees_expansion_from_the_centre(pairs):
    pair = pairs["forward"]
    x, y = rays_of(pair)
    np.testing.assert_allclose(pair.flow[..., 0] * y, pair.flow[..., 1] * x, atol=1e-9)
    assert (pair.flow[..., 0] * x + pair.flow[..., 1] * y > 0).all()


def test_a_point_that_passes_the_camera_has_no_flow():
    near = Plane(texture=PAINT, motion=(0, 0, -15, 0, 0, 0))
    far = Plane(texture=PAINT, point=(0, 0, 20))
    pair = Scene(objects=[near, far], camera=Camera(focal=8.0), height=6, width=8).render()
    assert np.isnan(pair.flow).all() and not pair.visible.any() and (pair.labels == 0).all()


# --- visibility -----------------------------------------------------------------------------


def passing_box(shift):
    """A box of 8×6 px passes `shift` px to the right, before a background at rest."""
    background = Plane(texture=PAINT)
    box = Box(
        texture=PAINT,
        center=(0, 0, 5.5),
        size=(8 / 20 * 5, 6 / 20 * 5, 1),
        motion=(shift / 20 * 5, 0, 0, 0, 0, 0),
    )
    return Scene(objects=[background, box], camera=Camera(focal=20.0), height=12, width=24)


def test_hidden_pixels_are_those_the_box_moves_over():
    pair = passing_box(3).render()
    expected = np.ones((12, 24), bool)
    expected[3:9, 16:19] = False
    assert (pair.visible == expected).all()
    assert (pair.labels[3:9, 8:16] == 1).all() and (pair.labels == 1).sum() == 48


def test_pixels_that_leave_the_image_are_not_visible():
    pair = passing_box(11).render()
    assert (pair.visible[3:9, 8:13]).all() and not pair.visible[3:9, 13:16].any()


# --- pictures -------------------------------------------------------------------------------


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
    coarse = pairs["two_blocks"]
    fine = two_blocks(480, 640, detail=0)
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


# --- options and sizes ----------------------------------------------------------------------


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


@settings(max_examples=25, deadline=None)
@given(
    normal=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1),
    distance=st.floats(1, 50),
)
def test_any_plane_is_hit_where_it_is(normal, distance):
    unit = np.array(normal) / np.linalg.norm(normal)
    backdrop = Plane(texture=PAINT, point=(0, 0, 1000))
    plane = Plane(texture=PAINT, point=distance * unit, normal=normal)
    camera = Camera(focal=9.0)
    pair = Scene(objects=[backdrop, plane], camera=camera, height=9, width=11).render(samples=1)
    x, y = rays_of(pair)
    toward = unit[0] * x + unit[1] * y + unit[2]
    expected = np.where(toward > 1e-12, distance / np.maximum(toward, 1e-12), np.inf)
    np.testing.assert_allclose(pair.depth, np.minimum(expected, 1000), rtol=1e-9)


# --- errors ---------------------------------------------------------------------------------


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
        (
            lambda: Scene(objects=[], camera=Camera(), height=2, width=2),
            "objects is empty",
        ),
        (
            lambda: Scene(
                objects=[Plane(texture=PAINT, point=(0, 0, -1))],
                camera=Camera(),
                height=2,
                width=2,
            ).render(),
            "background Plane",
        ),
    ],
)
def test_errors_say_what_came(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_objects_must_be_shapes():
    with pytest.raises(TypeError, match=r"objects\[1\] is a str: expected a Plane or a Box"):
        Scene(objects=[Plane(texture=PAINT), "box"], camera=Camera(), height=2, width=2)


# --- Parts without texture --------------------------------------------------------------------


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
