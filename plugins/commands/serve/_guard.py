"""Access control of the page: requests need the token, a local host name and the page's origin."""

from __future__ import annotations

import hmac
import secrets
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
"""Host names that can only mean this machine; any other name may stem from DNS rebinding by a foreign page."""
POLICY = "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def new_token() -> str:
    """A random token of 256 bits for a URL."""
    return secrets.token_urlsafe(32)


class Guard:
    """Passes requests with the token: once in the page's URL, afterwards in a cookie.

    Other requests get 403, as do those with a foreign host name (DNS rebinding), and changing requests from another
    origin than the page.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        if scope["type"] != "http":
            return None
        request = Request(scope)
        is_entry = request.method == "GET" and scope["path"] == "/"
        is_entry = is_entry and self._matches(request.query_params.get("token", ""))
        problem = self._problem(request, is_entry)
        app = self._app if problem is None else PlainTextResponse(f"{problem}\n", 403)

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if is_entry and problem is None:
                    cookie = f"{_cookie(request)}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                    headers.append("Set-Cookie", cookie)
            await send(message)

        return await app(scope, receive, answer)

    def _problem(self, request: Request, is_entry: bool) -> str | None:
        """Reason for refusing a request, or None."""
        host = request.headers.get("host", "")
        if _name_of(host) not in HOSTS:
            return "not under this name"
        if not is_entry and not self._matches(request.cookies.get(_cookie(request), "")):
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
    """A cookie name with the server's port, since cookies distinguish hosts, not ports."""
    server = request.scope.get("server") or ("", 0)
    return f"fluxbench_{server[1]}"
