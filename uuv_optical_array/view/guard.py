"""Who may open the page: who has its address, and from the page itself.

A browser sends what any site wants, but says truly what it looked up (Host) and who asks (Origin).
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

LONGEST_PATH = 200


def refusal(token: str, path: str, hosts: Sequence[str], origins: Sequence[str]) -> str:
    """Say why a request is not answered; empty where path, host and any origin are the page's."""
    given = f"{path}/".split("/")[1].partition("?")[0]
    if not secrets.compare_digest(given.encode(), token.encode()):
        return "open the whole address that the program printed"
    try:
        (host,) = hosts
        name = urlsplit(f"//{host}").hostname or ""
        if name not in ("localhost", socket.gethostname().lower()):
            ip_address(name)  # what another name stands for is up to its owner
        return "another page asks" if any(urlsplit(o).netloc != host for o in origins) else ""
    except ValueError:
        return f"host {', '.join(hosts)}: open the page by localhost or a number"


@contextmanager
def guarded(token: str) -> Iterator[None]:
    """Let a server of viser that starts in the block answer, below the token, as `refusal` says."""
    servers = needs("view", "websockets.asyncio.server")
    serve = servers.serve

    def serve_some(handle: Any, *address: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            named = request.headers.get_all("Host"), request.headers.get_all("Origin")
            if reason := refusal(token, request.path, *named):
                return connection.respond(403, f"{reason}\n")
            request.path = request.path[len(token) + 1 :] or "/"
            if len(request.path) > LONGEST_PATH:  # no file system has such a name
                return connection.respond(404, "there is no such page\n")
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
    words = " ".join(f"{type(error).__name__} {error or context.get('message')}".split())
    logging.getLogger(__name__).warning("not understood: a message from a browser: %s", words)
