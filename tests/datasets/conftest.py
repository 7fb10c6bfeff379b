"""Fixtures of the datasets."""

import pytest

from tests.datasets.made import MAKERS


@pytest.fixture(params=MAKERS)
def kind(request):
    return request.param


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    return folder
