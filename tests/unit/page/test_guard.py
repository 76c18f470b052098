"""Who is let in: the address with its token, then the cookie; nobody else, and by no other name."""

import pytest
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from vfm_sdm.page.guard import Guard

PORT, TOKEN = 8123, "a-token"


async def _talk(socket):
    await socket.accept()
    await socket.send_text("in")
    await socket.close()


@pytest.fixture
def client():
    routes = [Route("/", lambda _: PlainTextResponse("page")), WebSocketRoute("/ws", _talk)]
    return TestClient(Guard(Starlette(routes=routes), TOKEN, PORT), base_url=f"http://127.0.0.1:{PORT}")


def test_without_the_token_nothing_is_shown(client):
    for address in ("/", "/?token=", "/?token=other", f"/?token={TOKEN}x"):
        answer = client.get(address)
        assert answer.status_code == 403
        assert "page" not in answer.text.replace("vfm-sdm page", "")
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/ws"):
        pass


def test_the_address_lets_in_and_the_cookie_after_it(client):
    answer = client.get(f"/?token={TOKEN}")
    assert answer.text == "page"
    said = answer.headers["set-cookie"]
    assert "HttpOnly" in said
    assert "SameSite=Strict" in said
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert client.get("/").text == "page"
    with client.websocket_connect(f"ws://127.0.0.1:{PORT}/ws") as socket:
        assert socket.receive_text() == "in"


@pytest.mark.parametrize(
    "headers",
    [{"host": "evil.example"}, {"host": "127.0.0.1:9"}, {"origin": "http://evil.example"}, {"origin": "null"}],
)
def test_no_other_name_leads_here(client, headers):
    assert client.get(f"/?token={TOKEN}", headers=headers).status_code == 403


def test_a_cookie_of_another_port_does_not_count(client):
    client.cookies.set(f"vfm_sdm_page_{PORT + 1}", TOKEN)
    assert client.get("/").status_code == 403
