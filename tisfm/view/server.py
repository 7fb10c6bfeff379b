"""The server of the page."""

import contextlib
import io
import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viser import ViserServer


def start_server(host: str, port: int) -> "ViserServer":
    """Start viser at a port, or the next one that is free, without a word on standard output.

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
        raise ImportError(
            "the viewer needs viser, which is not installed: pip install 'tisfm[view]'"
        ) from error
    if not 0 <= port <= 65535:
        raise ValueError(f"port is {port}: expected 0 to 65535")
    _require_address(host)
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="tisfm", verbose=False)
    # A page could ask for a tunnel to the outside: this one stays where it was asked for.
    server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
    return server


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
