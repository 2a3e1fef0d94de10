"""What HTTP and browsers ask of every answer, whatever it is about.

ASGI middleware: bodies of bounded length, HEAD wherever there is GET, and no requests
that change something from the pages of other sites.
"""

from __future__ import annotations

from urllib.parse import urlsplit

from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY = 8 * 2**20
"""Bytes that the body of a request may have."""

SAFE = ("GET", "HEAD", "OPTIONS")
"""Methods that change nothing."""


class BodyLimit:
    """Stops reading a body past `MAX_BODY` bytes with a 413."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        seen = 0

        async def limited() -> Message:
            nonlocal seen
            message = await receive()
            seen += len(message.get("body", b""))
            if seen > MAX_BODY:
                raise HTTPException(413, f"the body is longer than {MAX_BODY} bytes")
            return message

        return await self.app(scope, limited, send)


class HeadAsGet:
    """Answers HEAD as GET, without the body (RFC 9110, 9.3.2)."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            return await self.app(scope, receive, send)

        async def headers_alone(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        return await self.app({**scope, "method": "GET"}, receive, headers_alone)


class OwnPagesAlone:
    """Refuses changes that the page of another site asks a browser for, with a 403.

    The server has no password: whoever reaches it may use it, and a browser reaches it
    for every page that is open in it.  Browsers say where a request comes from
    (``Sec-Fetch-Site``, or ``Origin`` beside ``Host``); other clients say nothing, and
    are let through.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        foreign = (
            scope["type"] == "http"
            and scope["method"] not in SAFE
            and _is_foreign(Headers(scope=scope))
        )
        if not foreign:
            return await self.app(scope, receive, send)
        message = "asked for by the page of another site; allowed: this server's own"
        refusal = JSONResponse({"error": {"type": "origin", "message": message}}, 403)
        await refusal(scope, receive, send)


def _is_foreign(headers: Headers) -> bool:
    site = headers.get("sec-fetch-site")
    if site is not None:
        return site not in ("same-origin", "none")
    origin = headers.get("origin")
    if origin is None:
        return False
    own = headers.get("x-forwarded-host") or headers.get("host")
    return urlsplit(origin).netloc != own


def methods_of(app: FastAPI, path: str) -> str:
    """Methods that are there for a path, for ``Allow``: by the schema, or a file's."""
    found = {
        method.upper()
        for template, operations in app.openapi()["paths"].items()
        if compile_path(template)[0].match(path)
        for method in operations
    }
    found = found or {"GET"}
    if "GET" in found:
        found.add("HEAD")
    return ", ".join(sorted(found))
