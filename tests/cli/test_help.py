"""Help: every setting, its default and its values."""

import re

import pytest

from tisfm.settings import Settings


def options_of(text):
    return set(re.findall(r"--[a-z][a-z-]+", text))


def test_help_names_the_commands(tisfm_run):
    code, out, _ = tisfm_run("--help")
    assert code == 0
    for word in ("run", "reconstruct", "demo", "eval", "figures", "tisfm run --help"):
        assert word in out


def test_help_of_batch_names_no_column_that_is_refused(tisfm_run):
    code, out, _ = tisfm_run("batch", "--help")
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert code == 0
    told = "A CSV file with columns source and output, and one for each option, such as focal."
    assert told in text


def test_help_of_run_names_every_setting_and_its_default(tisfm_run):
    code, out, _ = tisfm_run("run", "--help")
    assert code == 0
    settings = {"--" + name.replace("_", "-") for name in vars(Settings())}
    expected = {"--output", "--preset", "--step", "--resume", "--figures", "--no-figures"}
    expected |= {"--ply", "--no-ply", "--poses"}
    assert options_of(out) >= expected | settings | {
        "--arch",
        "--threads",
        "--focal",
        "--center",
        "--distortion",
    }
    assert "SOURCE [SOURCE ...]" in out
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert "(default: balanced)" in text and f"(default: {Settings().smoothness})" in text


@pytest.mark.parametrize("spelling", [["--preset", "paper"], ["--preset=paper"]])
def test_help_shows_the_values_of_the_preset(tisfm_run, spelling):
    code, out, _ = tisfm_run("run", *spelling, "--help")
    assert code == 0
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert re.search(r"--preset {paper,fast,balanced,accurate} .{0,100}\(default: paper\)", text)
    for name, value in vars(Settings.preset("paper")).items():
        option = "--" + name.replace("_", "-")
        following = re.split(re.escape(option) + "(?:, --no-| [A-Z{])", text, maxsplit=1)[1]
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        assert re.search(r"\(default: ([^)]*)\)", following).group(1) == shown, option


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("batch", {"--command", "--workers", "--threads", "--resume", "--no-resume", "--help"}),
        ("demo", {"--output", "--height", "--width", "--seed", "--threads", "--help"}),
        (
            "figures",
            {"--output", "--threads", "--camera", "--focal", "--center", "--distortion"}
            | {"--aspect", "--readout", "--help"},
        ),
        (
            "reconstruct",
            {
                "--output",
                "--preset",
                "--poses",
                "--motion",
                "--mask",
                "--labels",
                "--object-sizes",
                "--calibrate",
                "--depth-of",
                "--fixed-pixels",
                "--scale",
                "--workers",
                "--cluster",
                "--chunk",
                "--resume",
                "--no-resume",
            }
            | {"--report", "--no-report"}
            | {"--complete", "--no-complete", "--strict", "--no-strict"}
            | {"--ply", "--no-ply", "--mesh", "--arch", "--threads", "--step", "--start", "--stop"}
            | {"--size", "--crop", "--bad-frames", "--camera", "--focal", "--center"}
            | {"--distortion", "--aspect", "--readout", "--help"},
        ),
        ("report", {"--help"}),
        ("doctor", {"--json", "--no-json", "--help"}),
        (
            "eval",
            {"--output", "--layout", "--step", "--preset", "--threads", "--focal", "--center"}
            | {"--give-poses", "--no-give-poses", "--max-depth"}
            | {"--sequence", "--no-sequence", "--objects", "--no-objects", "--result"}
            | {"--arch", "--no-joint-edges", "--no-align-scales", "--help"}
            | {"--" + name.replace("_", "-") for name in vars(Settings())},
        ),
    ],
)
def test_help_of_the_others(tisfm_run, command, options):
    code, out, _ = tisfm_run(command, "--help")
    assert code == 0
    assert options_of(out) == options
