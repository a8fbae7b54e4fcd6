"""Who may open the page: who has its address, and from the page itself.

A browser sends what any site asks it to send, to this machine, too. What it says of itself it says
truly: under which name it found the server (Host), and which page asks (Origin).
"""

import asyncio
import logging
import secrets
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from uuv_optical_array.core.extras import needs

LOG = logging.getLogger(__name__)


def refusal(token: str, path: str, hosts: Sequence[str], origins: Sequence[str]) -> str:
    """Say why a request is not answered; empty where it is.

    Its path begins with the token. Its one host is a number, this machine's name or localhost, as
    another name may be one that somebody else lets point here. Its origin, if any, is that host.
    """
    given = f"{path}/".split("/")[1].partition("?")[0]
    if not secrets.compare_digest(given.encode(), token.encode()):
        return "open the whole address that the program printed"
    try:
        (host,) = hosts
        name = urlsplit(f"//{host}").hostname or ""
        if name not in ("localhost", socket.gethostname().lower()):
            ip_address(name)
        if any(urlsplit(origin).netloc != host for origin in origins):
            return "another page asks"
    except ValueError:
        return f"host {', '.join(hosts)}: open the page by localhost or a number"
    return ""


@contextmanager
def guarded(token: str) -> Iterator[None]:
    """Let a server of viser that starts in the block answer what `refusal` does not refuse.

    Paths are those below the token. What a browser sends amiss costs its connection, and a line.
    """
    servers = needs("view", "websockets.asyncio.server")
    serve = servers.serve

    def serve_some(handle: Any, *address: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            named = request.headers.get_all("Host"), request.headers.get_all("Origin")
            if reason := refusal(token, request.path, *named):
                return connection.respond(403, f"{reason}\n")
            request.path = request.path[len(token) + 1 :] or "/"
            return process_request(connection, request)

        async def handle_all(connection: Any) -> None:
            try:
                await handle(connection)
            except Exception as error:
                warn(None, {"exception": error})

        asyncio.get_running_loop().set_exception_handler(warn)
        return serve(handle_all, *address, process_request=process, **options)

    servers.serve = serve_some
    try:
        yield
    finally:
        servers.serve = serve


def warn(_: Any, context: dict[str, Any]) -> None:
    """Log in a line what a message from a browser led to, as a handler of an event loop."""
    error = context.get("exception")
    words = " ".join(f"{error or context.get('message', '')}".split())
    LOG.warning("not understood: a message from a browser: %s %s", type(error).__name__, words)
