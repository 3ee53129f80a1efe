"""The page as an ASGI application: a few files, the newest picture, the reports. Read-only."""

import asyncio
import contextlib
import hashlib
from functools import partial
from importlib import resources

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from orbitfb.page.feed import Feed
from orbitfb.page.guard import REPORT_POLICY, Guard
from orbitfb.page.job import PageJob
from orbitfb.page.reports import find_reports

FILES = {
    "index.html": "text/html",
    "page.css": "text/css",
    "page.js": "text/javascript",
    "charts.js": "text/javascript",
    "link.js": "text/javascript",
    "state.js": "text/javascript",
    "words.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}
ASSETS = "@ASSETS@"
"""Stands in the page for the name of its files."""
TOO_MANY = 4013
"""Code with which a viewer too many is turned away."""
PATIENCE = 10.0
"""How long a viewer may take nothing before it is dropped [s]."""


def page_app(job: PageJob, feed: Feed) -> Starlette:
    """Make the application.

    Args:
        job: What to show.
        feed: Gives the pictures.
    """
    files = {name: _file(name) for name in FILES}
    assets = hashlib.sha256(b"".join(files.values())).hexdigest()[:16]
    files["index.html"] = files["index.html"].replace(ASSETS.encode(), assets.encode())
    routes: list[BaseRoute] = [Route("/", partial(_send, "index.html", files["index.html"]))]
    routes += [Route(f"/{name}", partial(_send, name, content)) for name, content in files.items()]

    async def report(request: Request) -> Response:
        wanted = request.path_params["name"]
        found = await asyncio.to_thread(find_reports, job.data_directory)
        for its in found:
            if its.name == wanted:
                try:
                    content = await asyncio.to_thread(its.page)
                except OSError:
                    break
                policy = {"Content-Security-Policy": REPORT_POLICY}
                return Response(content, 200, policy, "text/html; charset=utf-8")
        return PlainTextResponse("no such report\n", 404)

    async def live(viewer: WebSocket) -> None:
        await viewer.accept()
        if not feed.join():
            await viewer.close(TOO_MANY, "too many viewers")
            return
        showing = asyncio.create_task(_show(viewer, feed, assets))
        ending = asyncio.create_task(viewer.receive())  # it leaves, or it speaks and has to leave
        try:
            await asyncio.wait((showing, ending), return_when=asyncio.FIRST_COMPLETED)
        finally:
            feed.leave()
            showing.cancel()
            ending.cancel()

    routes += [Route("/reports/{name}", report), WebSocketRoute("/live", live)]
    return Starlette(routes=routes, middleware=[Middleware(Guard, settings=job.web)])


async def _show(viewer: WebSocket, feed: Feed, assets: str) -> None:
    """Send one picture after the other, until it has gone or takes nothing any more."""
    number = 0
    with contextlib.suppress(WebSocketDisconnect, TimeoutError):
        await _say(viewer, feed.hello(assets))
        while True:
            number, picture = await feed.after(number)
            await _say(viewer, picture)


async def _say(viewer: WebSocket, text: str) -> None:
    await asyncio.wait_for(viewer.send_text(text), PATIENCE)


async def _send(name: str, content: bytes, _request: Request) -> Response:
    return Response(content, media_type=FILES[name])


def _file(name: str) -> bytes:
    return resources.files("orbitfb.page").joinpath("static", name).read_bytes()
