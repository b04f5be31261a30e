"""The page's addresses: GET reads, POST changes something."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_origin

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from orchestrator.validation.messages import first_problem
from plugins.commands.serve._choices import REPORT, choices, run_folder
from plugins.commands.serve._guard import Guard
from plugins.commands.serve._run import Checks, NotNowError, RunOfThePage
from plugins.commands.serve._shelf import Shelf
from plugins.commands.serve._view_pages import ViewPages
from plugins.commands.serve._wanted import Answer, ComparedRuns, RunLabelled, RunNamed, RunsWanted, Trend, Wanted
from protocols import FluxbenchError, InputError, Strict

T = TypeVar("T", bound=Strict)
Endpoint = Callable[[Request], Awaitable[Response]]

ASSETS = {
    "": ("index.html", "text/html"),
    "page.css": ("page.css", "text/css"),
    "page.js": ("page.js", "text/javascript"),
    "drawing.js": ("drawing.js", "text/javascript"),
    "shelf": ("shelf.html", "text/html"),
    "shelf.js": ("shelf.js", "text/javascript"),
}
MAX_BODY_BYTES = 1 << 16
REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""A report contains foreign text: no script in it is executed."""


def page_app(run: RunOfThePage, folder: Path, token: str) -> Starlette:
    """The application for one folder, protected by `Guard`."""
    page = _Page(run, folder)
    read = {
        "choices": page.choices,
        "events": page.events,
        "report/{run}": page.report,
        "listed": page.listed,
        "trend": page.trend,
        "labels": page.labels,
        "compared": page.compared,
    }
    changing = (page.check, page.start, page.resume, page.answer, page.stop, page.label, page.view)
    routes = [
        *(Route(f"/{path}", _asset(*asset), methods=["GET"]) for path, asset in ASSETS.items()),
        *(Route(f"/{path}", _with_errors(call), methods=["GET"]) for path, call in read.items()),
        *(Route(f"/{call.__name__}", _with_errors(call), methods=["POST"]) for call in changing),
    ]

    @asynccontextmanager
    async def closing_views(app: Starlette) -> AsyncIterator[None]:
        yield
        page.views.close()

    return Starlette(routes=routes, middleware=[Middleware(Guard, token=token)], lifespan=closing_views)


class _Page:
    """Handlers of the addresses, named like them."""

    def __init__(self, run: RunOfThePage, folder: Path) -> None:
        self._run, self._folder, self._checks = run, folder, Checks(folder)
        self._shelf, self.views = Shelf(folder, self._checks), ViewPages()

    async def choices(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(choices, self._folder) | await self._shelf.newest())

    async def listed(self, request: Request) -> Response:
        return JSONResponse(await self._shelf.listed(_query(request, RunsWanted)))

    async def trend(self, request: Request) -> Response:
        return JSONResponse(await self._shelf.trend(_query(request, Trend)))

    async def compared(self, request: Request) -> Response:
        return JSONResponse(await self._shelf.compared(_query(request, ComparedRuns)))

    async def events(self, request: Request) -> Response:
        return StreamingResponse(self._run.viewers.events(), media_type="text/event-stream")

    async def report(self, request: Request) -> Response:
        file = run_folder(self._folder, request.path_params["run"]) / REPORT
        if not file.is_file():
            return PlainTextResponse("this run has no report\n", 404)
        return FileResponse(file, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})

    async def check(self, request: Request) -> Response:
        code, out, err = await self._checks.run((await _body(request, Wanted)).checking(self._folder))
        if code:
            return _problem(err.removeprefix("fluxbench: ") or f"ended with {code}", 400)
        return Response(out, media_type="application/json")

    async def start(self, request: Request) -> Response:
        wanted = await _body(request, Wanted)
        self._run.start(wanted.running(self._folder), wanted.subject)
        return JSONResponse({})

    async def resume(self, request: Request) -> Response:
        named = await _body(request, RunNamed)
        self._run.start(["resume", str(run_folder(self._folder, named.run))], named.run)
        return JSONResponse({})

    async def answer(self, request: Request) -> Response:
        given = await _body(request, Answer)
        self._run.answer(given.question, given.answer)
        return JSONResponse({})

    async def labels(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self._shelf.labels, _query(request, RunNamed)))

    async def label(self, request: Request) -> Response:
        wanted = await _body(request, RunLabelled)
        await run_in_threadpool(self._shelf.label, wanted)
        return JSONResponse({})

    async def view(self, request: Request) -> Response:
        named = await _body(request, RunNamed)
        place = run_folder(self._folder, named.run)
        return JSONResponse({"address": await self.views.address_of(place)})

    async def stop(self, request: Request) -> Response:
        self._run.stop("stopped by a person at the page")
        return JSONResponse({})


def _asset(name: str, media_type: str) -> Endpoint:
    content = files("plugins.commands.serve").joinpath("page", name).read_bytes()

    async def asset(request: Request) -> Response:
        return Response(content, media_type=media_type)

    return asset


def _with_errors(call: Endpoint) -> Endpoint:
    """Endpoint that reports a request's error as one line with a status."""

    async def answered(request: Request) -> Response:
        try:
            return await call(request)
        except NotNowError as error:
            return _problem(str(error), 409)
        except FluxbenchError as error:
            return _problem(str(error), 400)

    return answered


def _problem(message: str, status: int) -> Response:
    return JSONResponse({"problem": message}, status)


def _query(request: Request, model: type[T]) -> T:
    """A request's parameters as `model`, whose lists have one for each item; raises `InputError`."""
    given: dict[str, Any] = {}
    for name, value in request.query_params.multi_items():
        field = model.model_fields.get(name)
        if field is not None and get_origin(field.annotation) is tuple:
            given.setdefault(name, []).append(value)
        else:
            is_number = field is not None and field.annotation is int and re.fullmatch(r"\d{1,15}", value)
            given[name] = int(value) if is_number else value
    return _validated(json.dumps(given).encode(), model)


async def _body(request: Request, model: type[T]) -> T:
    """A request's body as `model`; raises `InputError`."""
    raw = b""
    async for part in request.stream():
        raw += part
        if len(raw) > MAX_BODY_BYTES:
            raise InputError("request", "", f"longer than {MAX_BODY_BYTES} bytes")
    return _validated(raw, model)


def _validated(raw: bytes, model: type[T]) -> T:
    try:
        return model.model_validate_json(raw, strict=True)
    except ValidationError as error:
        problem = first_problem(error, model, _parsed(raw))
        raise InputError("request", problem.field, problem.text) from None


def _parsed(raw: bytes) -> Any:
    try:
        return json.loads(raw)
    except (ValueError, RecursionError):
        return None
