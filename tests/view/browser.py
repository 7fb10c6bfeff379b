"""A real browser without a window, where there is one."""

import shutil

import pytest

from tests.waiting import PATIENCE

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# WebGL without a GPU.
OPTIONS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip


def launched(playwright):
    """Return a browser; skip, saying why, where there is none."""
    from playwright.sync_api import Error

    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip("no Chromium: Debian has it as the package chromium")
    try:
        return playwright.chromium.launch(
            executable_path=path, args=list(OPTIONS), timeout=1000 * PATIENCE
        )
    except Error as error:
        pytest.skip(f"{path} does not start: {str(error).splitlines()[0]}")


def tab_of(browser, **options):
    """Return a tab in a new context with these options."""
    tab = browser.new_context(**options).new_page()
    tab.set_default_timeout(1000 * PATIENCE)
    return tab
