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

    page.thread.put(job)
    return found.result(timeout=PATIENCE)


def is_drawn(page):
    """Return whether a page has drawn all that was asked of it, and its thread rests."""
    return between_drawings(page, page.thread.is_idle)


def wait_until_drawn(page):
    """Wait until a page has drawn all that was asked of it."""
    wait_for(lambda: is_drawn(page))


def change(page, name, value):
    """Set a control; its own listeners, which viser calls at once, have to do the rest."""
    getattr(page.controls, name).value = value
