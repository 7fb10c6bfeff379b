"""Pages that tests open, and a browser that shows them."""

import pytest

from tests.view.browser import launched
from tisfm.results.opening import open_result


@pytest.fixture
def opened():
    """Open pages on results, and end them."""
    from tisfm.view.page import ViewerPage

    pages = []

    def page_of(folder, **options):
        pages.append(ViewerPage(open_result(folder), port=0, **options))
        return pages[-1]

    yield page_of
    for page in pages:
        page.stop()


@pytest.fixture(scope="module")
def browser():
    """Return a real browser."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        found = launched(playwright)
        yield found
        found.close()
