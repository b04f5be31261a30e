"""Who may speak to the page: whoever has the token, from this machine, on a page of ours; nobody else is answered."""

from __future__ import annotations

import hmac
import secrets
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
"""Names that lead here and nowhere else: under any other one a foreign page has had this address resolved."""
POLICY = "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def new_token() -> str:
    """256 bits that nobody guesses, as a word of a URL."""
    return secrets.token_urlsafe(32)


class Guard:
    """Lets requests through that carry the token: once in the URL of the page, from then on in a cookie.

    Others get 403, and so do requests under a foreign name of this machine (DNS rebinding) and what changes something
    and comes from another origin than the page.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        if scope["type"] != "http":
            return None
        request = Request(scope)
        comes_in = request.method == "GET" and scope["path"] == "/"
        comes_in = comes_in and self._matches(request.query_params.get("token", ""))
        problem = self._problem(request, comes_in)
        app = self._app if problem is None else PlainTextResponse(f"{problem}\n", 403)

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if comes_in and problem is None:
                    cookie = f"{_cookie(request)}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                    headers.append("Set-Cookie", cookie)
            await send(message)

        return await app(scope, receive, answer)

    def _problem(self, request: Request, comes_in: bool) -> str | None:
        """Why a request is not answered; None where it is."""
        host = request.headers.get("host", "")
        if _name_of(host) not in HOSTS:
            return "not under this name"
        if not comes_in and not self._matches(request.cookies.get(_cookie(request), "")):
            return "token missing or wrong: open the address that `fluxbench serve` has printed"
        if request.method not in ("GET", "HEAD") and request.headers.get("origin") != f"http://{host}":
            return "not from this page"
        return None

    def _matches(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _name_of(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _cookie(request: Request) -> str:
    """A name of its own for each server of this machine: cookies know hosts, not ports."""
    server = request.scope.get("server") or ("", 0)
    return f"fluxbench_{server[1]}"
