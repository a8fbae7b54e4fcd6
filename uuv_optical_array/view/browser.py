"""A Chromium without a window that opens the page, asks it, and takes its picture.

It is spoken to by the Chrome DevTools Protocol (https://chromedevtools.github.io/devtools-protocol/).
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

NAMES = "chromium", "chromium-browser", "google-chrome", "google-chrome-stable"
SIZE_PX = 1440, 900
PATIENCE_S = 60.0


def installed() -> str | None:
    """Return the path of a Chromium, or nothing where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of a browser that shows no window; to be closed, as a context does.

    Parameters
    ----------
    url
        Of the page.
    size_px
        Width and height of the page.

    Raises
    ------
    ValueError
        Where no Chromium is installed, or it does not start.
    """

    def __init__(self, url: str, size_px: tuple[int, int] = SIZE_PX) -> None:
        from websockets.sync.client import connect

        program = installed()
        if program is None:
            raise ValueError(f"no {' or '.join(NAMES)}: install one, such as Debian's chromium")
        self._profile = tempfile.TemporaryDirectory(
            prefix="uuv_optical_array_", ignore_cleanup_errors=True
        )
        options = [
            "--headless=new",
            "--remote-debugging-port=0",
            f"--user-data-dir={self._profile.name}",
            "--enable-unsafe-swiftshader",  # WebGL without a graphics card
            "--no-first-run",
        ]
        if os.geteuid() == 0:
            options.append("--no-sandbox")  # root has none
        self._process = subprocess.Popen(
            [program, *options, url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C in a terminal is for us
        )
        self._asked = 0
        try:
            with urllib.request.urlopen(f"{self._address()}/json/list", timeout=PATIENCE_S) as tabs:
                page = next(tab for tab in json.load(tabs) if tab["type"] == "page")
            self._socket = connect(page["webSocketDebuggerUrl"], max_size=None)
            width, height = size_px
            self._ask(
                "Emulation.setDeviceMetricsOverride",
                **{"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
            )
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _address(self) -> str:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if "DevTools listening on ws://" in line:
                return "http://" + line.split("ws://")[1].split("/")[0]
        raise ValueError("chromium does not start: run it by hand to see why")

    def _ask(self, method: str, **parameters: Any) -> Any:
        self._asked += 1
        self._socket.send(json.dumps({"id": self._asked, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if answer.get("id") == self._asked:
                return answer["result"]

    def evaluate(self, script: str) -> Any:
        """Return what a JavaScript expression gives, as plain values."""
        given = self._ask(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        return given["result"].get("value")

    def until(self, script: str) -> Any:
        """Wait until an expression gives something true, and return that.

        Raises
        ------
        ValueError
            Where it does not within `PATIENCE_S`.
        """
        end = time.monotonic() + PATIENCE_S
        while not (given := self.evaluate(script)):
            if time.monotonic() > end:
                raise ValueError(f"the browser waited {PATIENCE_S:g} s for {script}")
            time.sleep(0.1)
        return given

    def key(self, name: str) -> None:
        """Press a key, such as ``ArrowRight``, in what has the focus."""
        for kind in ("keyDown", "keyUp"):
            self._ask("Input.dispatchKeyEvent", type=kind, key=name, code=name)

    def picture(self) -> bytes:
        """Return the page as PNG, without the messages that lie over it."""
        # viser warns of a WebGL without a graphics card. Then two frames are drawn.
        self.evaluate(
            "document.querySelectorAll('.mantine-Notification-root').forEach(n => n.remove());"
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        return base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])

    def save(self, path: Path) -> None:
        """Write the page's picture as PNG."""
        path.write_bytes(self.picture())

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        self._process.communicate()
        self._profile.cleanup()
