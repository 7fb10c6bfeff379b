"""Fixtures of the tests of runs."""

from tests.cli.conftest import quick_workers  # noqa: F401
