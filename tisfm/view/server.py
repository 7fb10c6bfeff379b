"""The server of the page."""

import contextlib
import functools
import io
import re
import socket
from collections.abc import Iterator
from typing import TYPE_CHECKING

from tisfm.errors import InputError, MissingPackageError

if TYPE_CHECKING:
    from viser import ViserServer

_OF_THIS_COMPUTER = re.compile(r"https?://(127(\.\d+){3}|localhost|\[::1\])(:\d+)?")


def start_server(host: str, port: int) -> "ViserServer":
    """Start viser at a port, or the next one that is free, without a word on standard output.

    Where only this computer can reach it, pages that the browser has from elsewhere cannot either.

    Raises
    ------
    ImportError
        If viser is not installed.
    OSError
        If there is no such address here.
    ValueError
        If the port is none.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingPackageError(
            "the viewer needs viser, which is not installed: pip install 'tisfm[view]'"
        ) from error
    if not 0 <= port <= 65535:
        raise InputError(f"port is {port}: expected 0 to 65535")
    _require_address(host)
    alone = _from_here_alone() if _is_loopback(host) else contextlib.nullcontext()
    with alone, contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="tisfm", verbose=False)
    # A page could ask for a tunnel to the outside: this one stays where it was asked for.
    server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
    return server


def url_of(server: "ViserServer") -> str:
    """Return where a browser of this computer finds a server."""
    host = server.get_host()
    shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
    return f"http://{f'[{shown}]' if ':' in shown else shown}:{server.get_port()}"


def stop_server(server: "ViserServer") -> None:
    """End a server, without a word on standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


@contextlib.contextmanager
def _from_here_alone() -> Iterator[None]:
    """Let a server that starts in the block refuse what pages of other hosts ask for.

    A browser lets any page talk to this computer, and says where the page is from. viser has no
    option for that, but the library below has.
    """
    from websockets.asyncio import server

    serve = server.serve
    origins = (_OF_THIS_COMPUTER, None)  # None: what is no browser says nothing
    server.serve = functools.partial(serve, origins=origins)  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def _is_loopback(host: str) -> bool:
    return host in ("localhost", "::1") or host.startswith("127.")


def _require_address(host: str) -> None:
    """Raise OSError if nothing can listen at an address: viser would try for ever."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise OSError(f"cannot listen at {host}: {error.strerror or error}") from error
