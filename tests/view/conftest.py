"""Pages that tests open."""

import pytest

from tisfm.view.opening import open_result


@pytest.fixture
def opened():
    """Open pages on results, and end them."""
    from tisfm.view.page import Page

    pages = []

    def page_of(folder, **options):
        pages.append(Page(open_result(folder), port=0, **options))
        return pages[-1]

    yield page_of
    for page in pages:
        page.stop()
