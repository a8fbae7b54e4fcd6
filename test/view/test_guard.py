"""Nobody but the page itself operates the live view, and no message ends it."""

import logging
import threading
import urllib.error
import urllib.request
from contextlib import suppress
from urllib.parse import urlsplit

import msgspec.msgpack  # it and websockets come with viser
import pytest
from conftest import PATIENCE_S
from hypothesis import given, settings
from hypothesis import strategies as st
from page_sockets import messages_in, socket_of
from websockets.exceptions import ConnectionClosed, InvalidStatus

from uuv_optical_array.view.closed_loop import Conditions
from uuv_optical_array.view.guard import refusal
from uuv_optical_array.view.simulation import chosen, sliders

CAMERA = {
    **{"type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "fov": 1.0},
    **{"near": 0.1, "far": 9.0, "image_height": 9, "image_width": 9, "position": (1.0, 0.0, 0.0)},
    **{"look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0)},
}


def status(page, path, **headers):
    address = urlsplit(page.url)
    asked = urllib.request.Request(f"http://{address.netloc}{path}", headers=headers)
    try:
        with urllib.request.urlopen(asked, timeout=PATIENCE_S) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def uuids_of_sliders(socket, count):
    """Return how so many sliders of a page are called in its messages, by their labels."""
    uuids = {}
    while len(uuids) < count:
        for message in messages_in(socket.recv(timeout=PATIENCE_S)):
            if message["type"] == "GuiSliderMessage":
                uuids[message["props"]["label"]] = message["uuid"]
    return uuids


class Lines(logging.Handler):
    """The lines that the page logs, of loggers that pass nothing on, too, as those of launch."""

    def __init__(self):
        super().__init__()
        self.texts, self.came = [], threading.Semaphore(0)

    def emit(self, record):
        self.texts.append(record.getMessage())
        self.came.release()


@pytest.fixture
def lines():
    lines = Lines()
    loggers = [logging.getLogger(f"uuv_optical_array.view.{name}") for name in ("guard", "page")]
    for logger in loggers:
        logger.addHandler(lines)
    yield lines
    for logger in loggers:
        logger.removeHandler(lines)


def test_the_page_is_served_to_who_has_its_address_by_a_name_of_this_machine(page):
    path, port = urlsplit(page.url).path, urlsplit(page.url).port
    assert status(page, path) == status(page, f"{path}/?x=1") == 200
    assert status(page, path, Host=f"localhost:{port}") == 200
    assert status(page, "/") == status(page, f"{path}x") == status(page, "/index.html") == 403
    assert status(page, path, Host=f"evil.example:{port}") == 403
    assert status(page, path, Origin="http://evil.example") == 403
    assert status(page, f"{path}/../{path}") == 404
    assert status(page, f"{path}/{7000 * 'x'}") == status(page, f"{path}/{300 * 'x'}") == 404
    with socket_of(page.url, origin=page.url.removesuffix(path)) as socket:
        assert socket.recv(timeout=PATIENCE_S)
    for options in ({"origin": "http://evil.example"}, {"origin": "null"}, {"path": "/"}):
        with pytest.raises(InvalidStatus, match="403"), socket_of(page.url, **options):
            pass


@settings(max_examples=20)
@given(st.text(), st.text(), st.lists(st.text(), max_size=2))
def test_nothing_but_the_token_opens_it(path, host, origins):
    assert refusal("a token", path, [host], origins)
    assert refusal("a token", f"/a token/{path}", [], origins)
    assert not refusal("a token", "/a token?x", ["127.0.0.1:80"], ["http://127.0.0.1:80"])


def test_values_out_of_bounds_are_refused_in_a_line_and_sliders_go_back(page, lines):
    asked = []

    def change(values):
        asked.append(chosen(values))
        lines.came.release()

    given = sliders(Conditions(0.1))
    page.add_sliders("sea", given, change)
    attenuation, power, astern = (given[i].label for i in (0, 1, 5))
    wrong = [(attenuation, value) for value in (-5.0, float("nan"), float("inf"), 1e308)]
    with socket_of(page.url) as socket:
        uuids = uuids_of_sliders(socket, len(given))

        def set_value(label, value):
            updates = {"uuid": uuids[label], "updates": {"value": value}}
            socket.send(msgspec.msgpack.encode({"type": "GuiUpdateMessage", **updates}))
            assert lines.came.acquire(timeout=PATIENCE_S)

        socket.send(msgspec.msgpack.encode(CAMERA))
        for label, value in (*wrong, (power, -5.0), (astern, -7.0), (power, "x")):
            set_value(label, value)
        set_value(attenuation, 0.3)
        set_value(power, 0.5)
    assert asked == [Conditions(0.3), Conditions(0.3, (0.5,))]
    refused = [line for line in lines.texts if line.startswith("refused: ")]
    assert len(refused) == 6
    (other,) = set(lines.texts) - set(refused)
    assert other.startswith("not understood: a message from a browser: ValueError could not")
    assert "refused: k_per_m: nan is out of bounds; it must be from 0 to 10 1/m" in refused


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        b"\xff",
        "text",
        msgspec.msgpack.encode({"type": "NoSuch"}),
        msgspec.msgpack.encode({"type": "GuiUpdateMessage"}),
    ],
)
def test_a_malformed_frame_costs_its_connection_and_a_line(page, lines, capfd, frame):
    with socket_of(page.url) as socket:
        socket.send(frame)
        assert socket.recv(timeout=PATIENCE_S)  # the page, sent before
        while not socket.close_code:
            with suppress(ConnectionClosed):
                socket.recv(timeout=PATIENCE_S)
    (line,) = lines.texts
    assert line.startswith("not understood: ")
    assert "\n" not in line
    assert "Traceback" not in capfd.readouterr().err
    with socket_of(page.url) as socket:
        assert socket.recv(timeout=PATIENCE_S)
