"""The web server of the page."""

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

_LOCAL_ORIGIN = re.compile(r"https?://(127(\.\d+){3}|localhost|\[::1\])(:\d+)?")


def start_server(host: str, port: int) -> "ViserServer":
    """Start viser at a port, or the next free one, without output of its own.

    A server at a loopback address also refuses requests of web pages from other hosts.

    Raises ImportError if viser is not installed.

    Raises OSError if this computer does not have the address.

    Raises ValueError if the number is not a valid port.
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
    origin_check = _local_origins_only() if _is_loopback(host) else contextlib.nullcontext()
    with origin_check, contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="tisfm", verbose=False)
    # A page of viser can request a tunnel to the internet: this server refuses.
    server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
    return server


def url_of(server: "ViserServer") -> str:
    """Return the address of a server for a browser of this computer."""
    host = server.get_host()
    visible_host = "127.0.0.1" if host in ("0.0.0.0", "::") else host
    return (
        f"http://{f'[{visible_host}]' if ':' in visible_host else visible_host}:{server.get_port()}"
    )


def stop_server(server: "ViserServer") -> None:
    """Stop a server, without output of its own."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


@contextlib.contextmanager
def _local_origins_only() -> Iterator[None]:
    """Let a server that starts in the block refuse requests of web pages from other hosts.

    A browser lets every page connect to this computer, but sends the origin of the page. viser has
    no option to check the origin; the websockets library below it has.
    """
    from websockets.asyncio import server

    serve = server.serve
    origins = (_LOCAL_ORIGIN, None)  # None: clients other than browsers send no origin
    server.serve = functools.partial(serve, origins=origins)  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def _is_loopback(host: str) -> bool:
    return host in ("localhost", "::1") or host.startswith("127.")


def _require_address(host: str) -> None:
    """Raise OSError if no server can listen at an address: viser would try forever."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise OSError(f"cannot listen at {host}: {error.strerror or error}") from error
