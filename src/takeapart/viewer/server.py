"""The server behind the viewer's page: on this machine alone, and for pages of its own only.

Listening on the loopback address keeps other machines out, but not other pages in the same browser: a page from
elsewhere may open a socket to any address, and a name that is made to stand for 127.0.0.1 (DNS rebinding) makes the
viewer look like that page's own. So every request must name the viewer as its `Host`, and, where it names an `Origin`,
that too.
"""

from __future__ import annotations

import contextlib
import http
import io
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

from takeapart.model.errors import InputError, MissingExtraError, TakeapartError

try:
    import viser
    import websockets.asyncio.server
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response
except ImportError as missing:
    raise MissingExtraError("view", "view", "viser") from missing

LOOPBACK = "127.0.0.1"
HOSTS = (LOOPBACK, "localhost")  # that the page may be asked for, each with the server's port

# Nothing that stands in a page may run but the viewer's own program, nor reach any other address. Its program is part
# of the document, so scripts in the document are allowed, but none in attributes, frames or plug-ins.
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; script-src-attr 'none'; "
    "worker-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; "
    "font-src 'self' data:; "
    "connect-src 'self' ws://127.0.0.1:* ws://localhost:* blob: data:; frame-src 'none'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

Answer = Callable[[Any, Request], Response | None]
_exchange = threading.Lock()


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """The server prints to standard output, which belongs to the command."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def free_port() -> int:
    """A port of the loopback address that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def refusal(headers: Headers, port: int) -> str | None:
    """Why a request is refused, None where it may be answered.

    Args:
        headers: of the request.
        port: on which the server listens.
    """
    own = {f"{host}:{port}" for host in HOSTS}
    if headers.get_all("Host") not in [[host] for host in own]:
        return "this address belongs to a viewer on 127.0.0.1, and not to the host that was asked for"
    if any(origin not in {f"http://{host}" for host in own} for origin in headers.get_all("Origin")):
        return "the viewer answers no pages of other origins"
    return None


def guarded(answer: Answer | None) -> Answer:
    """What answers requests, behind the check of `Host` and `Origin`, and with the policy for what it sends."""

    def check(connection: Any, request: Request) -> Response | None:
        reason = refusal(request.headers, connection.local_address[1])
        if reason is not None:
            return Response(http.HTTPStatus.FORBIDDEN.value, "Forbidden", Headers(), f"{reason}\n".encode())
        response = None if answer is None else answer(connection, request)
        if response is not None:
            response.headers["Content-Security-Policy"] = POLICY
            response.headers["X-Content-Type-Options"] = "nosniff"
        return response

    return check


@contextlib.contextmanager
def _all_servers_guarded() -> Iterator[list[int]]:
    """Servers of websockets that are made meanwhile answer through `guarded`; yields one entry for each.

    viser hands nothing through to the library that listens for it, so what it calls there is exchanged while it starts.
    """
    made: list[int] = []
    original = websockets.asyncio.server.serve

    def serve(handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
        made.append(port)
        return original(handler, host, port, **(options | {"process_request": guarded(options.get("process_request"))}))

    with _exchange:
        websockets.asyncio.server.serve = serve  # type: ignore[assignment, misc]
        try:
            yield made
        finally:
            websockets.asyncio.server.serve = original  # type: ignore[misc]


def started_server(port: int | None) -> viser.ViserServer:
    """A server on the loopback address.

    Args:
        port: by default one that is free.

    Raises:
        InputError: the port is taken.
        TakeapartError: the library that serves does not let requests be checked.
    """
    with silence(), _all_servers_guarded() as made:
        server = viser.ViserServer(host=LOOPBACK, port=port or free_port(), label="takeapart", verbose=False)
    problem: TakeapartError | None = None
    if not made:
        problem = TakeapartError(f"viser {viser.__version__} starts its server in a way that cannot be guarded")
    elif port and server.get_port() != port:
        problem = InputError(f"{port} is taken on this machine; leave --port out to have a free one", "--port")
    if problem is not None:
        with silence():
            server.stop()
        raise problem
    return server
