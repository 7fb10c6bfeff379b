"""The pages of pictures: their cells run, draw what they should, and what they claim is so."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ("gallery", "settings_pictures", "failures")
CELL = re.compile(r"^```\{code-cell\} python\n((?::[^\n]*\n)*)(.*?)^```$", re.MULTILINE | re.DOTALL)
BY_CAMERA = ("pure_rotation", "little_parallax", "no_motion")


def cells(page):
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    assert text.startswith("---\nfile_format: mystnb\n")
    found = [code for _, code in CELL.findall(text)]
    assert len(found) == text.count("```{code-cell}")
    return found


def shown(code, title, names):
    """Run a cell, and return the figures that a notebook would show below it."""
    tree = ast.parse(code)
    is_silent = code.rstrip().endswith(";")
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, title, "exec"), names)
    value = (
        None if last is None else eval(compile(ast.Expression(last.value), title, "eval"), names)
    )
    assert is_silent or value is None or isinstance(value, Figure), f"{title} prints {value!r}"
    figures = [plt.figure(number) for number in plt.get_fignums()]
    return figures + [value] * isinstance(value, Figure)


@pytest.fixture
def no_window():
    before = matplotlib.get_backend()
    plt.switch_backend("agg")
    with plt.rc_context():
        yield
    plt.close("all")
    plt.switch_backend(before)


def test_first_claims_of_the_gallery_hold(no_window, tmp_path, monkeypatch):
    """Pages of pairs are short; the gallery's film and the other pages are nightly."""
    monkeypatch.chdir(tmp_path)
    names = {}
    for number, code in enumerate(cells("gallery")):
        if "room_film(" in code:
            break
        for figure in shown(code, f"gallery.md, cell {number}", names):
            check_drawn(figure)
        plt.close("all")
    flow_and_depth_are_near_the_truth(names)
    the_motion_explains_the_frames(names)


@pytest.mark.nightly
@pytest.mark.parametrize("page", PAGES)
def test_claims_of_the_page_hold(page, no_window, tmp_path, monkeypatch):
    """Its cells draw figures, and what the page claims holds."""
    monkeypatch.chdir(tmp_path)
    names = {}
    for number, code in enumerate(cells(page)):
        figures = shown(code, f"{page}.md, cell {number}", names)
        assert figures or number == 0, number  # the first may prepare the rest
        for figure in figures:
            figure.set_dpi(40)  # small ones are drawn fast
            figure.canvas.draw()
            check_drawn(figure)
        plt.close("all")
    assert not list(tmp_path.iterdir())
    for claim in CLAIMS[page]:
        claim(names)


def check_drawn(figure):
    for axes in figure.axes:
        is_room = axes.get_subplotspec() is None and not axes.axison  # of a legend
        assert is_room or axes.images or axes.lines or axes.collections or axes.patches
        for line in axes.lines:
            assert np.isfinite(line.get_ydata()).any()


@pytest.mark.parametrize("page", PAGES)
def test_the_page_states_how_the_site_is_built(page):
    assert "python -m sphinx docs build/docs" in (DOCS / f"{page}.md").read_text(encoding="utf-8")


def relative_deviation(result):
    seen = ~result.occlusion & (result.inverse_depth > 0)
    return np.median(result.inverse_depth_std[seen] / result.inverse_depth[seen])


def no_parallax_no_depth(failures):
    none, little, enough = failures["parallax"].values()
    assert none.status in BY_CAMERA and np.isnan(none.depth).all()
    assert little.status == "uncertain" and enough.status == "converged"
    assert relative_deviation(little) > 3 * relative_deviation(enough)
    error, scene = failures["error"], failures["enough"]
    assert error(little, scene) > 0.05 and error(enough, scene) < 0.03


def a_wrong_focal_length_bends_and_says_nothing(failures):
    error, scene = failures["error"], failures["corner"]
    short, right, long = (error(result, scene) for result in failures["focal"].values())
    assert short > 0.015 and right < 0.01 and long > 0.08
    assert {result.status for result in failures["focal"].values()} == {"converged"}
    depth = failures["scaled"]
    corner = [depth(result, scene)[90, 118:122].mean() for result in failures["focal"].values()]
    assert corner[0] < corner[1] < corner[2]  # flat to deep


def depth_of_field_is_wrong_where_the_camera_goes_forward(failures):
    rigid, translation, camera = failures["models"].values()
    assert {rigid.status, translation.status, camera.status} == {"converged"}
    error, scene = failures["error"], failures["forward"]
    assert error(rigid, scene) > 0.1 and error(translation, scene) > 0.1
    assert error(camera, scene) < 0.03


def bare_walls(failures):
    field, camera = failures["bare"].values()
    scene, error = failures["bare_room"], failures["error"]
    bare = ~scene.textured
    assert error(field, scene, bare) > 1.5 * error(camera, scene, bare)
    assert field.confidence[bare].mean() < 0.7 * field.confidence[scene.textured].mean()
    seen = ~camera.occlusion & (camera.inverse_depth > 0)
    relative = camera.inverse_depth_std[seen] / camera.inverse_depth[seen]
    assert np.median(relative[bare[seen]]) > 1.2 * np.median(relative[scene.textured[seen]])


def a_thing_that_moves_gets_a_wrong_depth(failures):
    camera, objects = failures["mover"].values()
    scene, error = failures["moving"], failures["error"]
    mover = ~failures["at_rest"]
    assert error(camera, scene, mover) > 0.1 > 0.05 > error(objects, scene, mover)
    assert error(camera, scene, failures["at_rest"]) < 0.03
    assert camera.status == objects.status == "converged"


def one_plane_leaves_two_motions(failures):
    one, other = failures["walls"]
    assert np.abs(one / other - 1).max() > 0.1
    true = failures["plane"].depth[90]
    assert min(np.abs(wall / true - 1).max() for wall in (one, other)) < 0.02
    alone, known = failures["planes"].values()
    assert alone.status == "two_motions" and known.status == "converged"
    assert failures["error"](known, failures["plane"]) < 0.02
    found = failures["scaled"](alone, failures["plane"])[90]
    assert np.mean(np.abs(found / true - 1)) > 0.3  # it is the other that is returned
    assert found[0] > found[-1] and true[0] < true[-1]


def light_and_blur(failures):
    both, brightness, by_both, by_brightness = failures["light"].values()
    gradient, shaken = failures["rest"].values()
    error, scene = failures["error"], failures["lit"]
    as_it_is = failures["interpreted"](scene, motion="field")
    assert both.status == brightness.status == "converged"
    assert error(both, scene) < 1.1 * error(as_it_is, scene)
    assert error(brightness, scene) > 1.6 * error(both, scene)
    assert by_brightness.status != "converged" and error(by_brightness, scene) > 0.5
    assert error(gradient, scene) < error(by_both, scene) < 0.06
    assert shaken.status in ("little_parallax", "uncertain")


def scale_is_what_a_pose_says(failures):
    small, large = failures["small"], failures["large"]
    assert np.array_equal(small.frame0, large.frame0)
    assert np.array_equal(small.frame1, large.frame1)
    ratio = failures["scales"][2].depth / failures["scales"][1].depth
    assert np.nanmedian(ratio) == pytest.approx(2, rel=1e-3)
    for size, scene in ((1, small), (2, large)):
        factor = np.nanmedian(scene.depth / failures["scales"][size].depth)
        assert factor == pytest.approx(1, abs=0.02)
    free = np.nanmedian(small.depth / failures["free"].depth)
    assert free == pytest.approx(0.05, rel=0.05)  # the length of the motion


def errors(settings, name, scene, of="flow"):
    return [settings["error"](result, settings[scene], of) for result in settings[name].values()]


MIDDLE = (
    ("smoothness", "patches", "flow", 2),
    ("beta", "patches", "flow", 2),
    ("contrast", "patches", "flow", 1.3),
    ("image_edges", "patches", "flow", 1.1),
    ("gradient", "patches", "flow", 1.1),
    ("data_contrast", "blocks", "flow", 3),
    ("normalization", "blocks", "flow", 1.05),
    ("depth_smoothness", "noisy", "depth", 1.3),
    ("depth_normalization", "noisy", "depth", 1),
)


def the_value_in_the_middle_is_the_preset_s_and_the_best(settings):
    for case in MIDDLE:
        is_best(settings, *case)


def is_best(settings, name, scene, of, worse):
    low, middle, high = errors(settings, name, scene, of)
    assert [title.endswith("*") for title in settings[name]] == [False, True, False]
    assert min(low, high) > worse * middle


def beta_and_smoothness_are_one_weight(settings):
    pairs = zip(settings["smoothness"].values(), settings["beta"].values(), strict=True)
    assert all(np.allclose(one.rho, other.rho, atol=1e-4) for one, other in pairs)


WITHOUT_PICTURE = (  # how much image motion changes, on average, px
    ("solver", "cholesky", 0.001),
    ("outer_iterations", 5, 0.001),
    ("outer_iterations", 100, 0.001),
    ("coarse_warps", 2, 0.02),
    ("coarse_warps", 16, 0.02),
    ("tolerance", 0.1, 0.03),
    ("tolerance", 0.002, 0.03),
    ("sweeps", 10, 0.03),
    ("sweeps", 20, 0.03),
    ("pyramid_factor", 0.7, 0.03),
    ("cycles", 1, 0.04),
    ("derivatives", "cube", 0.05),
)


def what_has_no_picture_changes_none(settings):
    text = (DOCS / "settings_pictures.md").read_text(encoding="utf-8")
    for scene in (settings[name] for name in ("blocks", "patches", "far")):
        usual = settings["interpreted"](scene, "balanced").flow[scene.visible]
        for setting, value, most in WITHOUT_PICTURE:
            assert re.search(rf"\| `{setting}` \| .*{value}.* \| {most} \|", text)
            other = settings["interpreted"](scene, "balanced", **{setting: value})
            change = np.linalg.norm(other.flow[scene.visible] - usual, axis=1).mean()
            assert change < most, (setting, value, change)


def every_setting_is_named(settings):
    text = (DOCS / "settings_pictures.md").read_text(encoding="utf-8")
    names = [field.name for field in fields(settings["tisfm"].Settings)]
    assert [name for name in names if f"`{name}`" not in text and f'"{name}"' not in text] == []


def joint_edges_have_narrower_rims(settings):
    separate, joint = errors(settings, "joint_edges", "grainy")
    assert separate > 1.05 * joint


def rotation_takes_depth_over(settings):
    rigid, translation = errors(settings, "model", "still", "depth")
    assert rigid > 2 * translation
    even, stiff = errors(settings, "stiffness", "still", "depth")
    assert even > 1.05 * stiff


def brightness_feels_the_light(settings):
    none, usual, much = errors(settings, "brightness", "brighter")
    assert max(none, usual) < 0.05 < 0.2 < much


def roughness(result):
    """Return how much inverse depth differs from that of the pixel beside it, relatively."""
    return np.median(np.abs(np.diff(result.inverse_depth))) / np.median(result.inverse_depth)


def figure_6(settings):
    small, paper, large = map(roughness, settings["figure_6"].values())
    assert small > 1.2 * paper > 1.4 * large


def figure_8(settings):
    """Spots that are taken for far vanish; the edge of the block, between columns, goes soft."""
    as_is, some, much = errors(settings, "figure_8", "patches", "depth")
    assert as_is > 1.5 * max(some, much)
    steepest = [np.abs(np.diff(r.inverse_depth)).max() for r in settings["figure_8"].values()]
    assert steepest[0] > 1.5 * steepest[2]


def levels_reach_far_and_warps_do_not(settings):
    one, two, all_levels = errors(settings, "pyramid_levels", "far")
    assert one > 10 * max(two, all_levels)
    few, usual, many = errors(settings, "warps", "far")
    assert few > usual > many > 10 * all_levels


def coarser_ends_are_softer(settings):
    finest, next_one, last = errors(settings, "finest_level", "blocks")
    assert finest < next_one / 1.5 < last / 3


def presets_from_the_paper_to_accurate(settings):
    paper, fast, balanced, accurate = errors(settings, "presets", "blocks")
    assert paper > 2 * fast > 2.5 * balanced > 2 * accurate


def flow_and_depth_are_near_the_truth(gallery):
    assert gallery["objects"].status == gallery["camera"].status == "converged"
    assert len(gallery["objects"].motions) == 3
    off = gallery["endpoint_error_map"](gallery["objects"].flow, gallery["moving"].flow)
    assert np.nanmean(off[gallery["moving"].visible]) < 0.1


def the_motion_explains_the_frames(gallery):
    assert gallery["left"].mean() < gallery["as_they_are"].mean() / 4


def the_sequence_is_near_the_truth(gallery):
    film, walk, metres = (gallery[name] for name in ("film", "walk", "metres"))
    gaps = metres * walk.poses[:, :3, 3] - film.poses[:, :3, 3]
    assert np.linalg.norm(gaps, axis=1).max() < 0.05  # m
    for k in (0, 5, 10, 15):
        assert np.nanmedian(np.abs(metres * walk.depth(k) / film.depth[k] - 1)) < 0.05


def points_and_surface_are_many(gallery):
    assert len(gallery["points"]) > 50_000 and len(gallery["room"]) > 5_000
    assert len(gallery["mesh"].faces) > 3_000


def the_energy_falls(gallery):
    past = gallery["past"]
    same = (np.diff(past.level) == 0) & (np.diff(past.warp) == 0)
    assert (np.diff(past.energy)[same] <= 1e-4 * past.energy[1:][same]).all()


CLAIMS = {
    "gallery": (
        flow_and_depth_are_near_the_truth,
        the_motion_explains_the_frames,
        the_sequence_is_near_the_truth,
        points_and_surface_are_many,
        the_energy_falls,
    ),
    "settings_pictures": (
        the_value_in_the_middle_is_the_preset_s_and_the_best,
        beta_and_smoothness_are_one_weight,
        figure_6,
        figure_8,
        levels_reach_far_and_warps_do_not,
        coarser_ends_are_softer,
        presets_from_the_paper_to_accurate,
        what_has_no_picture_changes_none,
        every_setting_is_named,
        joint_edges_have_narrower_rims,
        rotation_takes_depth_over,
        brightness_feels_the_light,
    ),
    "failures": (
        no_parallax_no_depth,
        a_wrong_focal_length_bends_and_says_nothing,
        depth_of_field_is_wrong_where_the_camera_goes_forward,
        bare_walls,
        a_thing_that_moves_gets_a_wrong_depth,
        one_plane_leaves_two_motions,
        light_and_blur,
        scale_is_what_a_pose_says,
    ),
}
