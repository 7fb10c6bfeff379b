"""Camera and Settings: what they accept, what they refuse and in which words."""

import dataclasses
import json
import math
from decimal import Decimal
from fractions import Fraction
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tisfm
from tisfm.settings import PAPER_SMOOTHNESS, Preset

PRESETS = get_args(Preset)
COUNTS = (
    "pyramid_levels",
    "warps",
    "coarse_warps",
    "outer_iterations",
    "sweeps",
    "finest_level",
    "cycles",
    "max_objects",
)
NUMBERS = (
    "smoothness",
    "beta",
    "contrast",
    "image_edges",
    "brightness",
    "gradient",
    "normalization",
    "data_contrast",
    "depth_smoothness",
    "depth_brightness",
    "depth_normalization",
    "presmoothing",
    "pyramid_factor",
    "relaxation",
    "tolerance",
)
NONE_IS_MEANT = ("contrast", "normalization", "data_contrast", "depth_normalization")
CHOICES = ("model", "motion", "derivatives", "solver")
OTHERS = ("joint_edges", "align_scales", "stiffness")

positive = st.floats(1e-3, 1e5)


def test_every_setting_is_covered_here():
    names = {field.name for field in dataclasses.fields(tisfm.Settings)}
    assert names == {*COUNTS, *NUMBERS, *CHOICES, *OTHERS}


# Presets


def test_no_arguments_are_the_preset_balanced():
    assert tisfm.Settings() == tisfm.Settings.preset() == tisfm.Settings.preset("balanced")


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_interprets(name):
    rng = np.random.default_rng(1)
    frame0 = rng.integers(0, 256, (24, 40), dtype=np.uint8)
    result = tisfm.interpret(
        frame0, np.roll(frame0, 1, 1), settings=tisfm.Settings.preset(name, outer_iterations=2)
    )
    assert result.settings.outer_iterations == 2
    assert np.isfinite(result.rho).all() and result.rho.any()


def test_presets_differ():
    assert len({tisfm.Settings.preset(name) for name in PRESETS}) == len(PRESETS)


def test_preset_paper_has_the_papers_values():
    paper = tisfm.Settings.preset("paper")
    assert paper.smoothness == PAPER_SMOOTHNESS == 1e8 / 600**2
    assert paper.beta == 0.25
    assert paper.alpha == pytest.approx(1e8 / 600**2 / 4)
    assert (paper.pyramid_levels, paper.warps, paper.derivatives) == (1, 1, "cube")
    assert (paper.brightness, paper.gradient, paper.image_edges) == (1, 0, 0)
    assert (paper.normalization, paper.data_contrast) == (None, None)
    assert (paper.joint_edges, paper.stiffness) == (False, (1,) * 6)
    # δ = 1 in the units of τ and ω is f pixels.
    assert paper.contrast is None
    assert paper.contrast_for(600.0) == 600.0
    assert paper.contrast_for(123.0) == 123.0


def test_preset_takes_changes():
    changed = tisfm.Settings.preset("paper", model="translation", contrast=0.05)
    assert changed == dataclasses.replace(
        tisfm.Settings.preset("paper"), model="translation", contrast=0.05
    )
    assert changed.contrast_for(600.0) == 0.05


@pytest.mark.parametrize("name", ["best", "Paper", "", None, 3, ["paper"]])
def test_unknown_preset_names_those_available(name):
    with pytest.raises(ValueError, match="preset is ") as caught:
        tisfm.Settings.preset(name)
    assert all(repr(preset) in str(caught.value) for preset in PRESETS)


def test_unknown_setting_names_those_available():
    with pytest.raises(ValueError, match="no setting is named iterations, lamda") as caught:
        tisfm.Settings.preset("fast", lamda=3, iterations=2, sweeps=3)
    assert all(name in str(caught.value) for name in (*COUNTS, *NUMBERS, *CHOICES))


# Values of Settings


def test_one_of_the_constraints_needs_a_weight():
    with pytest.raises(ValueError, match="brightness and gradient are both 0"):
        tisfm.Settings(brightness=0, gradient=0)


@pytest.mark.parametrize("name", ["joint_edges", "align_scales"])
@pytest.mark.parametrize("value", [1, None, "yes"])
def test_switches_are_true_or_false(name, value):
    with pytest.raises(TypeError, match=f"{name} is .*expected True or False"):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize("value", [3.0, None, "111111", (1, 1, 1), (1,) * 7])
def test_stiffness_has_six_numbers(value):
    with pytest.raises(TypeError, match=r"stiffness is .*expected 6 numbers"):
        tisfm.Settings(stiffness=value)


@pytest.mark.parametrize("value", [0, -1, math.nan, math.inf])
def test_stiffness_is_positive_and_finite(value):
    with pytest.raises(ValueError, match=r"stiffness\[2\] is .*expected a finite number"):
        tisfm.Settings(stiffness=(1, 1, value, 1, 1, 1))


def test_stiffness_may_come_as_a_list():
    settings = tisfm.Settings(stiffness=[1, 2, 3, 4, 5, 6])
    assert settings.stiffness == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert hash(settings) == hash(tisfm.Settings(stiffness=(1, 2, 3, 4, 5, 6)))


@pytest.mark.parametrize(
    ("name", "value", "possible"),
    [
        ("model", "affine", ("'rigid'", "'translation'")),
        ("motion", "layers", ("'field'", "'camera'", "'objects'")),
        ("derivatives", "sobel", ("'cube'", "'five_tap'")),
        ("solver", "svd", ("'cholesky'", "'closed_form'")),
        ("model", None, ("'rigid'", "'translation'")),
    ],
)
def test_unknown_choice_names_those_built(name, value, possible):
    with pytest.raises(ValueError, match=f"{name} is {value!r}") as caught:
        tisfm.Settings(**{name: value})
    assert all(choice in str(caught.value) for choice in possible)


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0, 10**400])
def test_numbers_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} is .*expected a finite number"):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize(
    ("name", "value", "bound"),
    [
        ("smoothness", 0, "at least 1e-06 and at most 1e\\+12"),
        ("smoothness", 1e38, "at least 1e-06 and at most 1e\\+12"),
        ("depth_smoothness", 1e13, "at least 1e-06 and at most 1e\\+12"),
        ("depth_smoothness", 1e-7, "at least 1e-06 and at most 1e\\+12"),
        ("beta", 0, "at least 1e-06 and at most 1e\\+06"),
        ("beta", 1e38, "at least 1e-06 and at most 1e\\+06"),
        ("contrast", 1e-4, "at least 0.001 and at most 1e\\+06"),
        ("contrast", 1e7, "at least 0.001 and at most 1e\\+06"),
        ("presmoothing", 1e6, "at least 0 and at most 100"),
        ("relaxation", 0, "at least 0.01 and below 2"),
        ("relaxation", 2, "at least 0.01 and below 2"),
        ("pyramid_factor", 0.49, "at least 0.5 and at most 0.95"),
        ("pyramid_factor", 0.96, "at least 0.5 and at most 0.95"),
        ("presmoothing", -0.1, "at least 0"),
        ("tolerance", -1e-9, "at least 0"),
    ],
)
def test_errors_state_the_bounds(name, value, bound):
    with pytest.raises(ValueError, match=bound):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pyramid_factor", 0.5),
        ("pyramid_factor", 0.95),
        ("presmoothing", 0),
        ("tolerance", 0),
        ("cycles", 0),
        ("finest_level", 0),
        ("pyramid_levels", 1),
        ("pyramid_levels", None),
        ("contrast", None),
        ("smoothness", 1e-6),
        ("smoothness", 1e12),
        ("depth_smoothness", 1e12),
        ("sweeps", 1000),
        ("max_objects", 255),
    ],
)
def test_bounds_themselves_are_accepted(name, value):
    assert getattr(tisfm.Settings(**{name: value}), name) == value


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", ["1", True, 1j, Decimal(1), [1.0], np.array([1.0])], ids=repr)
def test_other_values_than_numbers_are_refused(name, value):
    with pytest.raises(TypeError, match=f"{name} is .*expected a number"):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize("name", [name for name in NUMBERS if name not in NONE_IS_MEANT])
def test_none_is_no_number(name):
    with pytest.raises(TypeError, match=f"{name} is None"):
        tisfm.Settings(**{name: None})


@pytest.mark.parametrize(
    "name", [name for name in COUNTS if name not in ("finest_level", "cycles")]
)
@pytest.mark.parametrize("value", [0, -1])
def test_counts_start_at_one(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}: expected at least 1"):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize("name", COUNTS)
@pytest.mark.parametrize("value", [2**31, 3_000_000_000, 10**400])
def test_counts_end_before_a_run_cannot(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}: expected at least [01] and at most"):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize(("smoothness", "beta"), [(1e12, 2.0), (1e-6, 0.5), (1e7, 1e6)])
def test_smoothness_and_beta_are_bounded_together(smoothness, beta):
    with pytest.raises(ValueError, match=r"smoothness · beta is .* expected a product of at least"):
        tisfm.Settings(smoothness=smoothness, beta=beta)


@pytest.mark.parametrize("name", COUNTS)
@pytest.mark.parametrize("value", [1.0, 2.5, "2", True, np.float64(2), math.nan], ids=repr)
def test_counts_are_integers(name, value):
    with pytest.raises(TypeError, match=f"{name} is .*expected an integer"):
        tisfm.Settings(**{name: value})


@pytest.mark.parametrize("name", COUNTS[1:])
def test_only_levels_may_be_left_open(name):
    with pytest.raises(TypeError, match=f"{name} is None"):
        tisfm.Settings(**{name: None})


@pytest.mark.parametrize(
    ("given_value", "plain"),
    [(np.float32(1.5), 1.5), (np.int64(1), 1.0), (np.uint8(1), 1.0), (Fraction(3, 2), 1.5), (1, 1)],
    ids=repr,
)
def test_numbers_of_other_types_become_floats(given_value, plain):
    settings = tisfm.Settings(smoothness=given_value)
    assert type(settings.smoothness) is float and settings.smoothness == plain
    assert settings == tisfm.Settings(smoothness=plain)
    assert hash(settings) == hash(tisfm.Settings(smoothness=plain))
    json.dumps(dataclasses.asdict(settings))


@pytest.mark.parametrize("name", COUNTS)
def test_counts_of_numpy_types_become_ints(name):
    settings = tisfm.Settings(**{name: np.int32(3)})
    assert type(getattr(settings, name)) is int
    assert settings == tisfm.Settings(**{name: 3})


def test_settings_are_frozen_hashable_and_keyword_only():
    settings = tisfm.Settings()
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.smoothness = 3.0
    assert {settings: "known"}[tisfm.Settings()] == "known"
    with pytest.raises(TypeError):
        tisfm.Settings("rigid")


def test_components_follow_the_model():
    assert tisfm.Settings(model="rigid").components == 6
    assert tisfm.Settings(model="translation").components == 3


@given(smoothness=positive, beta=positive, contrast=st.none() | positive, focal=positive)
def test_derived_values(smoothness, beta, contrast, focal):
    settings = tisfm.Settings(smoothness=smoothness, beta=beta, contrast=contrast)
    assert settings.alpha == smoothness * beta
    assert settings.contrast_for(focal) == (focal if contrast is None else contrast)


# Camera


def test_coarser_levels_have_twice_the_warps_up_to_a_bound():
    settings = tisfm.Settings(warps=3, coarse_warps=20)
    assert [settings.warps_on(level) for level in range(5)] == [3, 6, 12, 20, 20]
    assert tisfm.Settings(warps=5, coarse_warps=2).warps_on(0) == 5


def test_camera_defaults_to_the_papers_focal_length_and_the_images_centre():
    camera = tisfm.Camera()
    assert camera.focal == 600.0
    assert camera.center is None
    assert camera.center_for(480, 641) == (320.0, 239.5)
    assert camera.center_for(1, 1) == (0.0, 0.0)
    assert tisfm.Camera(center=(1, 2)).center_for(480, 641) == (1.0, 2.0)


@pytest.mark.parametrize("focal", [0, -5, -0.0])
def test_focal_length_must_be_positive(focal):
    with pytest.raises(ValueError, match="the focal length must be positive"):
        tisfm.Camera(focal=focal)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400])
def test_camera_must_be_finite(value):
    with pytest.raises(ValueError, match=r"focal is .*finite"):
        tisfm.Camera(focal=value)
    with pytest.raises(ValueError, match=r"center\[1\] is .*finite"):
        tisfm.Camera(center=(0, value))


@pytest.mark.parametrize("value", ["600", None, True, 1j, [600.0]], ids=repr)
def test_camera_takes_numbers_only(value):
    with pytest.raises(TypeError, match=r"focal is .*expected a number"):
        tisfm.Camera(focal=value)
    with pytest.raises(TypeError, match=r"center\[0\] is .*expected a number"):
        tisfm.Camera(center=(value, 1.0))


@pytest.mark.parametrize("center", [3.0, (1,), (1, 2, 3), "x", [[1, 2]]], ids=repr)
def test_center_is_a_pair(center):
    with pytest.raises(ValueError, match=r"center is .*give the principal point as \(cx, cy\)"):
        tisfm.Camera(center=center)


@pytest.mark.parametrize("center", [[1, 2], np.array([1, 2]), np.array([1, 2], np.float32)])
def test_camera_of_numpy_values_is_plain(center):
    camera = tisfm.Camera(focal=np.float32(50), center=center)
    assert camera == tisfm.Camera(50.0, (1.0, 2.0))
    assert hash(camera) == hash(tisfm.Camera(50.0, (1.0, 2.0)))
    assert type(camera.focal) is float and type(camera.center[0]) is float


def test_camera_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        tisfm.Camera().focal = 3.0


@given(scale=st.floats(0.1, 4), focal=positive, x=st.floats(-500, 500), y=st.floats(-500, 500))
def test_scaled_camera_sees_the_same_rays(scale, focal, x, y):
    """Pixel x of an image lies at (x + ½)·scale − ½ on the resampled one; its ray stays."""
    camera = tisfm.Camera(focal=focal)
    scaled = camera.scaled(scale, 48, 64)
    cx, cy = camera.center_for(48, 64)
    new_cx, new_cy = scaled.center_for(1, 1)
    assert ((x + 0.5) * scale - 0.5 - new_cx) / scaled.focal == pytest.approx(
        (x - cx) / focal, abs=1e-9 * (1 + 1 / focal) * (1 + abs(x))
    )
    assert ((y + 0.5) * scale - 0.5 - new_cy) / scaled.focal == pytest.approx(
        (y - cy) / focal, abs=1e-9 * (1 + 1 / focal) * (1 + abs(y))
    )


def test_scaling_by_one_changes_nothing_but_makes_the_centre_explicit():
    assert tisfm.Camera(50.0).scaled(1.0, 24, 40) == tisfm.Camera(50.0, (19.5, 11.5))


def test_centre_of_an_even_image_stays_its_centre_when_halved():
    assert tisfm.Camera(50.0).scaled(0.5, 24, 40) == tisfm.Camera(
        25.0, tisfm.Camera().center_for(12, 20)
    )


def test_submodules_load_when_named():
    for name in ("egomotion", "formats", "horn_schunck", "metrics", "scenes", "show"):
        assert getattr(tisfm, name).__name__ == f"tisfm.{name}"
        assert name in dir(tisfm)
    with pytest.raises(AttributeError, match="no_such_module"):
        tisfm.no_such_module  # noqa: B018
