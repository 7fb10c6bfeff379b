"""The processes that run other libraries' methods."""

import ast
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.shared.contest import MethodFailure, score
from bench.shared.peer_process import WORKER, Peer, find_peers, survey
from bench.shared.sequences import scene_pairs
from tests.waiting import PATIENCE


def test_the_worker_needs_nothing_of_this_project():
    tree = ast.parse(WORKER.read_text(encoding="utf-8"))
    names = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    roots = {name.partition(".")[0] for name in names}
    assert roots <= sys.stdlib_module_names | {"numpy", "cv2", "skimage"}


@pytest.fixture
def dis(tmp_path):
    peer = Peer(
        "OpenCV DIS fast", python=Path(sys.executable), threads=1, folder=tmp_path, timeout=PATIENCE
    )
    yield peer
    peer.close()


def test_a_worker_gives_flow_and_starts_again_after_it_died(dis):
    first, second = scene_pairs(96, 128)
    expected = dis.run(first).flow
    assert score(expected, first, dis.name).epe < 1
    dis._worker._process.kill()
    dis._worker._process.wait()
    with pytest.raises(MethodFailure, match="its process died with status"):
        dis.run(second)
    np.testing.assert_array_equal(dis.run(first).flow, expected)


def test_an_error_of_a_library_is_reported_and_the_worker_goes_on(dis):
    pair = scene_pairs(96, 128)[0]
    other = np.zeros((10, 12), np.uint8)
    unequal = replace(pair, name="unequal", frame1=other)
    with pytest.raises(MethodFailure, match="error"):
        dis.run(unequal)
    assert dis.run(pair).flow.shape == (96, 128, 2)


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands for Python")
def test_a_worker_that_does_not_answer_is_ended(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexec sleep 1000\n")
    python.chmod(0o755)
    peer = Peer("OpenCV DIS fast", python=python, threads=1, folder=tmp_path, timeout=0.2)
    with pytest.raises(MethodFailure, match="without an answer"):
        peer.run(scene_pairs(24, 32)[0])


def test_every_peer_is_available_or_missing_for_a_reason():
    found = survey(Path(sys.executable))
    assert "OpenCV DIS medium" in found.available
    assert all(found.missing.values())
    with pytest.raises(RuntimeError, match=r"does not run peer_worker\.py"):
        survey(Path("no-such-python"))
    _, found = find_peers(Path("no-such-python"))
    assert not found.available and "no-such-python" in found.missing["all peers"]
    assert find_peers(None)[0] == Path(sys.executable)
