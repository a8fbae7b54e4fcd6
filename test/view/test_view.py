"""The page of the live view, in plain numbers and in a real Chromium."""

import math
import re
import socket
import sys
import threading
import time
import urllib.request
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from urllib.parse import urlsplit

import matplotlib.image
import msgspec.msgpack
import numpy as np
import pytest
import viser
from conftest import PATIENCE_S
from hypothesis import given
from hypothesis import strategies as st
from page_sockets import messages_in, socket_of
from scipy.spatial.transform import Rotation

from uuv_optical_array.commands.view import address
from uuv_optical_array.control.following import State
from uuv_optical_array.estimation.pipeline import Answer
from uuv_optical_array.view.browser import Browser, installed
from uuv_optical_array.view.charts import known
from uuv_optical_array.view.page import Page, Slider
from uuv_optical_array.view.shapes import ellipsoid
from uuv_optical_array.view.sight import WINDOW_S, Sight, Window, note_on
from uuv_optical_array.view.words import headline, words

TRUE = np.array([-6.0, 0.3, -0.2, 0.1, 3.1])
STATE = "coasting for 5 s", "the lamp is hidden"
COASTING = State("coasting", -2.0, "the lamp is hidden")
SPREAD = np.diag([0.04, 0.01, 0.0025, 1e-4, 4e-4])  # sigma 0.2, 0.1, 0.05 m, 0.57, 1.15 deg


def sight(t_s, **more):
    """Return an instant whose estimate is 0.1 m too far and 0.1 rad of yaw beyond pi."""
    pose = TRUE + np.array([-0.1, 0.0, 0.0, 0.0, 0.1 - 2 * np.pi])
    known = {"true_pose": TRUE, "pose": pose, "covariance": SPREAD, "image": 400 * np.eye(5)}
    return Sight(t_s, **{**known, **more})


def test_charts_show_errors_about_0_where_the_truth_is_known():
    window = Window()
    for i in range(3):
        window.add(sight(0.1 * i))
    window.add(sight(0.3, pose=None, covariance=None))
    t_s, error, low, high = window.bands(0)
    np.testing.assert_allclose(t_s, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(error, [-0.1] * 3 + [np.nan])
    np.testing.assert_allclose(high, [0.6] * 3 + [np.nan])
    np.testing.assert_allclose(low, -high)
    np.testing.assert_allclose(window.bands(4)[1][:3], np.degrees(0.1))
    np.testing.assert_allclose(window.bands(4)[3][:3], 3 * np.degrees(0.02))
    np.testing.assert_allclose(window.peaks()[1], 400)


def test_charts_show_the_estimate_where_the_truth_is_not_known():
    window = Window()
    window.add(sight(0.0, true_pose=None))
    value, low, high = (band[0] for band in window.bands(1)[1:])
    assert (value, low, high) == pytest.approx((0.3, 0.0, 0.6))


def test_charts_show_the_last_minute_and_begin_anew_with_time():
    window = Window()
    assert window.add(sight(0.0))
    assert not window.add(sight(1.0))
    assert not window.add(sight(WINDOW_S + 0.5))
    assert list(window.bands(0)[0]) == [1.0, WINDOW_S + 0.5]
    assert window.add(sight(2.0))
    assert list(window.peaks()[0]) == [2.0]


@given(st.integers(0, 2**32 - 2))
def test_the_ellipsoid_is_where_the_mahalanobis_distance_is_three(seed):
    rng = np.random.default_rng(seed)
    root = Rotation.random(random_state=seed + 1).as_matrix() * rng.uniform(0.05, 3, 3)
    turn = Rotation.random(random_state=seed).as_matrix()
    half_axes, axes = ellipsoid(root @ root.T, turn)
    assert np.linalg.det(axes) == pytest.approx(1)
    ball = rng.normal(size=(20, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    in_beacon = (ball * half_axes) @ axes.T @ turn.T
    distances = np.linalg.norm(np.linalg.solve(root, in_beacon.T), axis=0)
    np.testing.assert_allclose(distances, 3, rtol=1e-9)


def test_a_chart_gets_what_is_known_whole():
    t_s, value = known(np.arange(4.0), np.array([1.0, np.nan, 3.0, 4.0]))
    assert (list(t_s), list(value)) == ([0.0, 2.0, 3.0], [1.0, 3.0, 4.0])
    t_s, value, other = known(np.arange(2.0), np.array([1.0, 2.0]), np.array([np.nan, 1.0]))
    assert len(t_s) == 2
    assert np.isnan([value, other]).all()


def test_the_numbers_are_in_metres_and_degrees():
    rows = [
        re.findall(r"<td[^>]*>([^<]*)", row) for row in words(sight(0.0), 1, 1).split("<tr>")[2:]
    ]
    assert rows == [
        ["true", "-6.00", "+0.30", "-0.20", "+5.7", "+177.6"],
        ["estimate", "-6.10", "+0.30", "-0.20", "+5.7", "-176.7"],
        ["sigma", "0.20", "0.10", "0.05", "0.6", "1.1"],
    ]
    note = note_on(Answer(0, None, None, "no fit: p < 1e-6"))
    dark = words(sight(0.0, pose=None, covariance=None, note=note), 2, 3)
    assert len(dark.split("<tr>")) == 5  # nothing below moves
    assert re.findall(r"<td[^>]*>([^<]*)", dark.split("<tr>")[3]) == ["estimate", *5 * ["&ndash;"]]
    assert "2 of the last 3 images have a pose" in dark
    assert "refused: no fit: p &lt; 1e-6" in dark
    assert note_on(Answer(0, None, None, "no light: 2 counts")) == "no light: 2 counts"


def test_the_state_is_shown_with_its_time_and_the_end_of_a_search_with_its_cure():
    def shown(name, since_s, again=""):
        html = headline(State(name, since_s, "why < so"), 12.4, again)
        (colour,) = re.findall(r"font-size:22px;color:(#\w{6})", html)
        return re.findall(r"<b[^>]*>([^<]*)</b>", html), "why &lt; so" in html, colour

    coasting, locked = shown("coasting", 9.3), shown("locked", -2.0)
    lost = shown("lost", 2.0, "start again")
    assert [text for (text,), *_ in (coasting, locked, lost)] == [
        "coasting for 3 s",
        "locked for 14 s",
        "lost: start again",
    ]
    assert all(why for _, why, _ in (coasting, locked, lost))
    assert len({colour for *_, colour in (coasting, locked, lost)}) == 3
    assert shown("lost", 2.0)[0] == ["lost for 10 s"]
    assert shown("waiting", math.nan)[0] == ["waiting"]
    assert "<b" in headline(None, 0.0)


def test_without_viser_it_says_what_to_install(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ValueError, match=r"-m pip install 'viser>=1\.1'"):
        Page(scene, "none")


def test_no_browser_opens_a_tunnel_to_the_internet(scene, monkeypatch):
    asked, answered = [], threading.Semaphore(0)

    def shared(server):
        asked.append(server)
        answered.release()

    monkeypatch.setattr(viser.ViserServer, "request_share_url", shared)
    monkeypatch.setattr(viser.ViserServer, "disconnect_share_url", lambda _: answered.release())
    page, plain = (
        Page(scene, "a test", port=18200),
        viser.ViserServer("127.0.0.1", 18400, verbose=False),
    )
    try:
        for url, kinds in (
            (page.url, ("ShareUrlRequest", "ShareUrlDisconnect")),
            (f"http://127.0.0.1:{plain.get_port()}", ("ShareUrlRequest",)),
        ):
            with socket_of(url) as socket:
                for kind in kinds:
                    socket.send(msgspec.msgpack.encode({"type": kind}))
                assert answered.acquire(timeout=PATIENCE_S)
    finally:
        page.close()
        plain.stop()
    assert asked == [plain]  # as where nothing forbids it


def test_a_browser_hears_nothing_of_an_instant_until_all_of_it_is_told(scene, monkeypatch):
    servers, halfway = [], []

    class Known(viser.ViserServer):
        def __init__(self, *words, **options):
            super().__init__(*words, **options)
            servers.append(self)

    def followers(frame):
        """Return where the messages of a frame place the follower."""
        named = [each for each in messages_in(frame) if each.get("name") == "/follower"]
        return [each["position"] for each in named if "position" in each]

    def await_follower(socket, place):
        while pytest.approx(place) not in followers(socket.recv(timeout=PATIENCE_S)):
            pass

    monkeypatch.setattr(viser, "ViserServer", Known)
    page = Page(scene, "a test", port=18500)
    try:
        with socket_of(page.url) as socket:
            page.show(sight(0.0))
            await_follower(socket, TRUE[:3].tolist())

            def slow_words(*given):
                for _ in range(20):  # whatever there is to send is sent by then
                    servers[0].flush()
                    assert socket.ping().wait(PATIENCE_S)
                with suppress(TimeoutError):
                    while True:
                        halfway.extend(followers(socket.recv(timeout=0)))
                return words(*given)

            monkeypatch.setattr("uuv_optical_array.view.page.words", slow_words)
            page.show(sight(0.1, true_pose=TRUE + 1.0))
            assert not halfway
            await_follower(socket, (TRUE[:3] + 1.0).tolist())
    finally:
        page.close()


def test_the_page_is_for_this_machine_only(page):
    port = urlsplit(page.url).port
    socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S).close()
    with pytest.raises(ConnectionRefusedError):
        # Loopback, too, but another address: served where all addresses are.
        socket.create_connection(("127.0.0.2", port), timeout=PATIENCE_S)


def test_the_next_free_port_is_taken_and_an_address_of_another_machine_refused(page, scene):
    other = Page(scene, "another", port=urlsplit(page.url).port)
    other.close()
    assert urlsplit(other.url).port != urlsplit(page.url).port
    assert urlsplit(other.url).path != urlsplit(page.url).path
    for host in ("192.0.2.1", "no such name", "100::1"):  # RFC 5737: nobody's
        with pytest.raises(ValueError, match=f"host: '{host}' cannot be served"):
            Page(scene, "elsewhere", host)


@pytest.mark.skipif(not Path("/proc/net/if_inet6").exists(), reason="there is no IPv6")
def test_an_address_of_ipv6_is_served_and_stands_in_brackets(scene):
    page = Page(scene, "sixth", *address("[::1]:18300"))
    try:
        assert page.url.startswith("http://[::1]:18")
        with urllib.request.urlopen(page.url, timeout=PATIENCE_S) as answer:
            assert answer.status == 200
    finally:
        page.close()


CHARTS = """(() => {
  const charts = Object.values((window.__viserTestpoints || {}).uplots || {});
  const shown = charts.map(c => c.chart.data.map(row => Array.from(row)));
  const scaled = charts.every(({chart: {scales: {x, y}, data}}) =>
    x.min == -60 && x.max == 0 && y.min <= -0.1 == data.length > 2
    && (y.max < 20 || data.length == 2));
  const lengths = shown.map(d => d[0].length).sort();
  return lengths == "29,29,29,29,29,30" && scaled ? shown : null;
})()"""
SLIDER = "document.querySelector('[role=slider]')"
IMAGE = "[...document.querySelectorAll('img')].find(image => image.offsetHeight)"
BRIGHTEST = f"""(() => {{
  const canvas = document.createElement('canvas').getContext('2d');
  canvas.drawImage({IMAGE}, 0, 0);
  return Math.max(...canvas.getImageData(0, 0, 250, 150).data.filter((_, i) => i % 4 < 3));
}})()"""


def colours(browser):
    """Return the picture's colours, 0 to 255, shape ``(height, width, 3)``."""
    picture = matplotlib.image.imread(BytesIO(browser.picture()), format="png")
    return np.rint(255 * picture[..., :3]).astype(int)


def sea(picture):
    """Return the part of the page that is the sea."""
    return picture[:, 300:-360]


def orange(picture):
    """Return how many pixels have a colour that only the leader has."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    return np.sum((red > 150) & (green > 80) & (green < 190) & (blue < 60))


@pytest.fixture
def dim_page(scene, monkeypatch):
    """A page without the image that lights it, half of the time without a graphics card."""

    class Dim(viser.ViserServer):
        def __init__(self, *words, **options):
            super().__init__(*words, **options)
            self.scene.configure_environment_map(None)

    monkeypatch.setattr(viser, "ViserServer", Dim)
    page = Page(scene, "a test", port=18080)
    yield page
    page.close()


@pytest.mark.skipif(installed() is None, reason="no Chromium: apt-get install chromium")
def test_a_browser_shows_numbers_charts_image_and_leader_and_moves_a_slider(dim_page):
    page, chosen = dim_page, []
    sliders = [Slider("K (1/m)", "attenuation", 0.0, 1.0, 0.1, 0.5)]
    page.add_sliders("sea", sliders, lambda values: chosen.append(values))
    with Browser(page.url, (1240, 480)) as browser:
        browser.until("Object.keys((window.__viserTestpoints || {}).uplots || {}).length == 6")
        for i in range(3):  # a run before, whose errors leave the charts and their scales
            page.show(sight(100.0 + i, pose=np.full(5, 50.0)))
        page.show(sight(0.0, pose=None, covariance=None))
        for i in range(1, 30):
            page.show(sight(0.1 * i, note="no light: it is off", state=COASTING, lit=(True,)))
        charts = browser.until(CHARTS)
        text = browser.until("document.body.innerText.includes('2.9 s') && document.body.innerText")
        for line in (
            "a test",
            "K (1/m)",
            "x (m)",
            "estimate less truth",
            "no light: it is off",
            *STATE,
        ):
            assert line in text
        assert "brightest detector 400 counts" in text
        assert "-6.10" in text  # the estimate of x
        (light,) = (data for data in charts if len(data) == 2)
        np.testing.assert_allclose(light[1], 400)
        np.testing.assert_allclose(light[0], np.arange(-29, 1) / 10, atol=1e-9)
        errors = [data for data in charts if len(data) == 4]
        assert sum(np.allclose(d[1], -0.1) and np.allclose(d[3], 0.6) for d in errors) == 1
        assert browser.evaluate(BRIGHTEST) > 200
        top = "getBoundingClientRect().top"  # a phone shows sliders and state together
        assert browser.evaluate(f"{IMAGE}.{top} > {SLIDER}.{top}")
        browser.evaluate(f"{SLIDER}.focus()")
        browser.key("ArrowRight")
        browser.until(f"{SLIDER}.getAttribute('aria-valuenow') == '0.6'")
        assert chosen[-1] == [pytest.approx(0.6)]
        end = time.monotonic() + PATIENCE_S
        # Without a graphics card the first takes its time.
        while orange(sea(colours(browser))) < 50:
            assert time.monotonic() < end, "no leader to be seen"
        lit = sea(colours(browser))
        page.show(sight(3.0, lit=(False,), image=2 * np.eye(5)))
        browser.until(f"{BRIGHTEST} < 150")  # noise is not drawn as light
        while np.sum(np.abs(sea(colours(browser)) - lit).max(axis=-1) > 3) < 2000:
            assert time.monotonic() < end, "the beam of a lamp that is off"
        assert browser.evaluate(
            "performance.getEntriesByType('resource').every("
            "r => r.name.startsWith(location.origin)"
            " || r.name.startsWith('data:') || r.name.startsWith('blob:'))"
        )


@pytest.mark.skipif(installed() is None, reason="no Chromium: apt-get install chromium")
def test_a_phone_shows_the_leader_above_the_panels(dim_page):
    dim_page.show(sight(0.0))
    with Browser(dim_page.url, (390, 844)) as browser:
        browser.until("document.body.innerText.includes('0.0 s')")
        end = time.monotonic() + PATIENCE_S
        while orange(colours(browser)[:338]) < 50:
            assert time.monotonic() < end, "no leader to be seen"
