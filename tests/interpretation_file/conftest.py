"""Results, and the files that keep them."""

import pytest

from tests.interpretation_file.stored import field_result, rigid_result


@pytest.fixture(scope="module")
def result():
    return field_result()


@pytest.fixture(scope="module")
def rigid():
    return rigid_result()


@pytest.fixture
def saved(result, tmp_path):
    path = tmp_path / "result.npz"
    result.save(path)
    return path


@pytest.fixture
def saved_rigid(rigid, tmp_path):
    path = tmp_path / "rigid.npz"
    rigid.save(path)
    return path
