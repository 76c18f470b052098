"""Who may ask the page: only the browser that was given its address, on this machine."""

import secrets
from http.cookies import SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["Guard"]

_REFUSED = b"403: expected the address that vfm-sdm page printed, with its token; open that one"


class Guard:
    """Middleware that refuses requests without the token of this start, or by another name than this machine's.

    Parameters
    ----------
    app
        What is guarded.
    token
        The token: in the address of the first request, then in a cookie.
    port
        Where the page listens.

    Notes
    -----
    The name is checked because a page of somebody else could have its own name lead to this machine (DNS rebinding).
    Cookies know no ports, so the port is part of the name.
    """

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app, self._token, self._cookie = app, token, f"vfm_sdm_page_{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on, or refuses it.

        Parameters
        ----------
        scope, receive, send
            As of ASGI.
        """
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        by_address = secrets.compare_digest(given.encode(), self._token.encode())
        kept = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        by_cookie = kept is not None and secrets.compare_digest(kept.value.encode(), self._token.encode())
        own = headers.get("host", "") in self._hosts
        origin = headers.get("origin")
        own &= origin is None or origin.removeprefix("http://") in self._hosts
        if not (own and (by_address or by_cookie)):
            await self._refuse(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                extra = [(b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff")]
                if by_address:
                    cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    extra.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        await self._app(scope, receive, answer)

    async def _refuse(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
            return
        headers = [(b"content-type", b"text/plain; charset=utf-8")]
        await send({"type": "http.response.start", "status": 403, "headers": headers})
        await send({"type": "http.response.body", "body": _REFUSED})
