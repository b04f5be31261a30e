"""Hands one file to the viewer's page: under a token, to that page's origin alone, on this machine alone.

The viewer's own server knows no password: what it is given, everybody on the machine can ask for. It is given nothing.
"""

from __future__ import annotations

import hmac
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route

from plugins.streams.rerun._live import HOST


@contextmanager
def handed_out(file: Path, origin: str) -> Iterator[str]:
    """Where the page of this origin finds the file, as it is then, while the block lasts."""
    token = secrets.token_urlsafe(32)
    with socket.socket() as listening:
        listening.bind((HOST, 0))
        listening.listen()
        host = f"{HOST}:{listening.getsockname()[1]}"
        app = Starlette(routes=[Route("/{token}/{name}", _handler(file, token, host, origin), methods=["GET"])])
        config = uvicorn.Config(
            app, access_log=False, log_config=None, log_level="critical", server_header=False, ws="none", lifespan="off"
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listening],), name="view's file", daemon=True)
        thread.start()
        try:
            yield f"http://{host}/{token}/{quote(file.name)}"
        finally:
            server.should_exit = True
            thread.join()


def _handler(file: Path, token: str, host: str, origin: str) -> Callable[[Request], Awaitable[Response]]:
    async def hand(request: Request) -> Response:
        is_known = hmac.compare_digest(request.path_params["token"].encode(), token.encode())
        if not is_known or request.headers.get("host") != host:
            return PlainTextResponse("token missing or wrong\n", 403)
        headers = {"Access-Control-Allow-Origin": origin, "Cache-Control": "no-store"}
        return FileResponse(file, media_type="application/octet-stream", headers=headers)

    return hand
