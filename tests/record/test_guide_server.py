"""The guide's page: who may read it, and what it may load."""

import http.client
import os
import sys
from collections.abc import Iterator
from unittest.mock import Mock
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from raising import raises
from typed import present

from kinectbench.core.errors import SettingsError
from kinectbench.core.geometry import Camera
from kinectbench.record.guide import process
from kinectbench.record.guide.guide import NICER, Guide
from kinectbench.record.guide.process import _Shown
from kinectbench.record.guide.server import FILES, Answer, PageServer
from kinectbench.record.interface import Frame, Setup


@pytest.fixture
def server() -> Iterator[PageServer]:
    answers: dict[str, Answer] = {
        "state": lambda query: ("application/json", query.encode() or b"{}"),
        "mesh": lambda query: None,
    }
    made = PageServer(answers, posts={"pick": lambda body: "" if body == b"here" else "nothing é"})
    yield made
    made.close()


def ask(
    server: PageServer, path: str, method: str = "GET", body: str | None = None, **headers: str
) -> http.client.HTTPResponse:
    address = urlsplit(server.url)
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=10)
    connection.request(method, path, body, headers={"Host": address.netloc, **headers})
    answer = connection.getresponse()
    answer.body = answer.read()  # type: ignore[attr-defined]
    connection.close()
    return answer


def test_files_and_answers_come_with_the_token(server: PageServer) -> None:
    base = urlsplit(server.url).path
    for name, (_, kind) in FILES.items():
        answer = ask(server, base + name)
        assert answer.status == 200 and answer.headers["Content-Type"] == kind
    assert ask(server, base + "state?7").body == b"7"  # type: ignore[attr-defined]
    assert ask(server, base + "state").body == b"{}"  # type: ignore[attr-defined]
    assert ask(server, base + "mesh").status == 204 and ask(server, base + "other").status == 404
    assert ask(server, base + "picture?3").status == 404


def test_without_its_token_nothing_is_served(server: PageServer) -> None:
    token = urlsplit(server.url).path.strip("/")
    for path in ("/", "/state", f"/{token[:-1]}/", f"/{token}x/state", "/../", "/%C3%A9/"):
        assert ask(server, path).status == 403
    assert len(token) >= 20


def test_names_of_other_hosts_and_origins_are_refused(server: PageServer) -> None:
    """A page elsewhere cannot read it by a name that leads to this machine; a tunnel's port may be any."""
    base, port = urlsplit(server.url).path, urlsplit(server.url).port
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", "", "localhost:x"):
        assert ask(server, base, Host=host).status == 403
    for origin in ("http://evil.example", "null", "https://localhost:9000"):
        assert ask(server, base, Host="localhost:9000", Origin=origin).status == 403
    assert ask(server, base, Host="localhost:9000", Origin="http://localhost:9000").status == 200
    assert ask(server, base, Host="127.0.0.1:9000").status == 200


def test_the_page_may_load_its_own_files_only(server: PageServer) -> None:
    answer = ask(server, urlsplit(server.url).path)
    assert answer.headers["Content-Security-Policy"].startswith("default-src 'self'")
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert "Access-Control-Allow-Origin" not in answer.headers
    assert ask(server, urlsplit(server.url).path, "PUT").status == 501


def test_only_the_page_itself_may_post(server: PageServer) -> None:
    """A click needs the page's origin and its token, a known name, and a short body that says where."""
    base, host = urlsplit(server.url).path, urlsplit(server.url).netloc
    own = {"Origin": f"http://{host}", "body": "here"}
    assert ask(server, f"{base}pick", "POST", **own).status == 204
    refused = ask(server, f"{base}pick", "POST", **{**own, "body": "there"})
    assert (refused.status, refused.body.decode()) == (422, "nothing é")  # type: ignore[attr-defined]
    assert ask(server, f"{base}pick", "POST", body="here").status == 403
    assert ask(server, f"{base}pick", "POST", **{**own, "Origin": "http://evil.example"}).status == 403
    assert ask(server, "/x/pick", "POST", **own).status == 403
    assert ask(server, f"{base}state", "POST", **own).status == 404
    assert ask(server, f"{base}pick", "POST", **{**own, "body": "h" * 1001}).status == 404
    for length in ("9" * 5000, "-1", "x"):
        assert (
            ask(server, f"{base}pick", "POST", Origin=own["Origin"], **{"Content-Length": length}).status
            == 404
        )


def test_a_reader_that_goes_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    def gone(query: str) -> None:
        raise ConnectionResetError

    made = PageServer({"state": gone})
    with pytest.raises(http.client.RemoteDisconnected):
        ask(made, f"{urlsplit(made.url).path}state")
    made.close()
    assert capfd.readouterr() == ("", "")


def test_a_port_that_is_taken_is_one_line(server: PageServer) -> None:
    with raises(SettingsError, "settings.wrong-value", "--port"):
        PageServer({}, urlsplit(server.url).port or 0)


@pytest.mark.parametrize("registered", [True, False])
def test_the_picture_that_is_clicked_has_the_pixels_of_depth(registered: bool) -> None:
    """Colour that is not registered sees another place at the same pixel: depth is shown."""
    depth = np.full((240, 320), 1000, np.uint16)
    depth[:, 160:], depth[0, 0] = 3000, 65535  # one of the largest values, which RealSense gives for none
    red = np.tile(np.array([200, 0, 0], np.uint8), (240, 320, 1))
    shown = _Shown(None)
    camera = Camera(320, 240, 290.0, 290.0, 159.5, 119.5)
    shown.take(0, Frame(0, depth, red), Setup(camera, 1000.0, registered))
    assert shown.state("") is not None
    _, jpeg = present(shown.picture("0"))
    picture = present(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR))
    left, right = picture[120, 80], picture[120, 240]
    assert (right - left.astype(int) > 60).all() != registered
    assert (abs(left - [0, 0, 200.0]) < 10).all() == registered


def test_the_process_ends_without_waiting_for_its_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("os.nice", "signal.signal", "warnings.simplefilter"):
        monkeypatch.setattr(name, Mock())
    monkeypatch.setattr("os._exit", Mock(side_effect=SystemExit))
    with pytest.raises(SystemExit):
        process._run(Mock(recv=Mock(side_effect=EOFError)), 0, None)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts niceness by thread")
def test_the_object_is_looked_at_after_the_camera_is_tracked() -> None:
    guide = Guide(Setup(Camera(64, 48, 50.0, 50.0, 31.5, 23.5), 1000.0, False))
    assert guide._pool is not None
    assert guide._pool.submit(os.nice, 0).result() == min(os.nice(0) + NICER, 19)
    guide.close()
