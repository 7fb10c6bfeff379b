"""Pages without a browser: tests wait until they are drawn, and set their controls."""

from concurrent.futures import Future

from tests.waiting import PATIENCE, wait_for


def between_drawings(page, look):
    """Return what the thread that draws finds where it is not drawing."""
    found = Future()

    def job():
        try:
            found.set_result(look())
        except BaseException as error:
            found.set_exception(error)

    page._jobs.put(job)
    page._wake.set()
    return found.result(timeout=PATIENCE)


def is_drawn(page):
    """Return whether a page has drawn all that was asked of it, and its thread rests."""

    def look():
        is_left = page._is_stale or page._is_coarse or page._without_picture
        return page._jobs.empty() and not is_left

    return between_drawings(page, look)


def wait_until_drawn(page):
    """Wait until a page has drawn all that was asked of it."""
    wait_for(lambda: is_drawn(page))


def change(page, name, value):
    """Set a control; its own listeners, which viser calls at once, have to do the rest."""
    getattr(page.controls, name).value = value
