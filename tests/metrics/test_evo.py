"""What the program evo makes of the same files."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.draws import nightly_except
from tests.metrics.test_trajectory import TURN, shaken
from tests.trajectory.paths import random_path, similar
from tisfm.metrics import absolute_errors, relative_errors
from tisfm.trajectory import read_kitti, read_tum, write_kitti, write_tum

DIGITS = 1e-6  # evo prints so many


@pytest.fixture
def evo(tmp_path):
    """Run a command of evo, with a home folder of its own; return its root mean square."""

    def run(program, *arguments):
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
        found = shutil.which(program, path=path)
        if found is None:
            pytest.skip(f"{program} is not installed: pip install evo")
        home = tmp_path / "home"
        home.mkdir(exist_ok=True)
        done = subprocess.run(
            [found, *map(str, arguments)],
            env=os.environ | {"HOME": str(home), "USERPROFILE": str(home)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return float(re.search(r"rmse\s+([\d.e+-]+)", done.stdout).group(1))

    return run


@pytest.fixture
def paths(tmp_path):
    """Files of a true path and of one found, of which frames are missing, in both formats."""
    rng = np.random.default_rng(4)
    truth = random_path(rng, 40)
    found = similar(shaken(truth, rng, 0.1), 0.3, TURN, [1, 2, 3])
    times = 100 + np.arange(40) / 30
    write_kitti(tmp_path / "truth.txt", truth)
    write_kitti(tmp_path / "found.txt", found)
    found[[0, 11, 12, 39]] = np.nan
    write_tum(tmp_path / "truth.tum", truth, times)
    write_tum(tmp_path / "found.tum", found, times + 0.004)  # another clock
    return tmp_path, truth, found


def test_absolute_errors(evo, paths):
    folder, truth, found = paths
    files = folder / "truth.tum", folder / "found.tum"
    errors = absolute_errors(found, truth)
    assert evo("evo_ape", "tum", *files, "-as") == pytest.approx(errors.similarity, abs=DIGITS)
    assert evo("evo_ape", "tum", *files, "-a") == pytest.approx(errors.rigid, abs=DIGITS)
    whole = [folder / "truth.txt", folder / "found.txt"]
    errors = absolute_errors(read_kitti(whole[1]).poses, read_kitti(whole[0]).poses)
    assert evo("evo_ape", "kitti", *whole, "-as") == pytest.approx(errors.similarity, abs=DIGITS)
    assert evo("evo_ape", "kitti", *whole, "-a") == pytest.approx(errors.rigid, abs=DIGITS)


@pytest.mark.parametrize("step", nightly_except(5, of=[1, 5]))
def test_relative_errors(evo, paths, step):
    folder, truth, _ = paths
    # It counts frames that both files have, so both have all here.
    files = folder / "truth.txt", folder / "found.txt"
    whole = read_kitti(files[1]).poses
    scale = absolute_errors(whole, truth).scale
    errors = relative_errors(whole, truth, step=step, scale=scale)
    options = ["-as", "-d", step, "-u", "f", "--all_pairs"]
    for relation, expected in (("trans_part", errors.translation), ("angle_deg", errors.rotation)):
        value = evo("evo_rpe", "kitti", *files, *options, "-r", relation)
        assert value == pytest.approx(expected, abs=DIGITS)


def test_evo_reads_written_files(evo, paths):
    """The file of one format, taken as the truth of that of the other."""
    folder, _, _ = paths
    found = read_tum(folder / "found.tum")
    write_tum(folder / "again.tum", found.poses, found.times)
    assert evo("evo_ape", "tum", folder / "found.tum", folder / "again.tum") < DIGITS
