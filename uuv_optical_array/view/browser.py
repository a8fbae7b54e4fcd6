"""The page in a headless Chromium: scripts and pictures by the Chrome DevTools Protocol.

See https://chromedevtools.github.io/devtools-protocol/.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from typing import Any

NAMES = "chromium", "chromium-browser", "google-chrome", "google-chrome-stable"
SIZE_PX = 1440, 900
PATIENCE_S = 60.0


def installed() -> str | None:
    """Return the path of a Chromium, or ``None``."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page, closed at the end of a context; ValueError where no Chromium starts."""

    def __init__(self, url: str, size_px: tuple[int, int] = SIZE_PX) -> None:
        from websockets.sync.client import connect

        program = installed()
        if program is None:
            raise ValueError(f"no {' or '.join(NAMES)}: install one, such as Debian's chromium")
        self._profile = tempfile.TemporaryDirectory(
            prefix="uuv_optical_array_", ignore_cleanup_errors=True
        )
        options = ["--headless=new", "--remote-debugging-port=0", "--no-first-run"]
        options.append(f"--user-data-dir={self._profile.name}")
        options.append("--enable-unsafe-swiftshader")  # WebGL without a graphics card
        if os.geteuid() == 0:
            options.append("--no-sandbox")  # root has none
        out = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        # In a session of its own a terminal's Ctrl-C does not reach it.
        words: dict[str, Any] = {**out, "text": True, "start_new_session": True}
        self._process = subprocess.Popen([program, *options, "about:blank"], **words)
        self._calls = 0
        try:
            with urllib.request.urlopen(f"{self._address()}/json/list", timeout=PATIENCE_S) as tabs:
                page = next(tab for tab in json.load(tabs) if tab["type"] == "page")
            self._socket = connect(page["webSocketDebuggerUrl"], max_size=None)
            width, height = size_px
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self._call("Emulation.setDeviceMetricsOverride", **size)
            self._call("Page.navigate", url=url)  # the page has its size from the start
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
        raise ValueError("chromium does not start; run it by hand to see the reason")

    def _call(self, method: str, **parameters: Any) -> Any:
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if answer.get("id") == self._calls:
                return answer["result"]

    def evaluate(self, script: str) -> Any:
        """Return the value of a JavaScript expression."""
        how = {"returnByValue": True, "awaitPromise": True}
        return self._call("Runtime.evaluate", expression=script, **how)["result"].get("value")

    def until(self, script: str) -> Any:
        """Wait until an expression is true, `PATIENCE_S` at most, and return its value."""
        end = time.monotonic() + PATIENCE_S
        while not (value := self.evaluate(script)):
            if time.monotonic() > end:
                raise ValueError(f"the browser waited {PATIENCE_S:g} s for {script}")
            time.sleep(0.1)
        return value

    def key(self, name: str) -> None:
        """Press a key, such as ``ArrowRight``, in the element that has the focus."""
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, key=name, code=name)

    def picture(self) -> bytes:
        """Return the page as PNG, without notifications, after two frames were drawn."""
        # viser warns of WebGL without a graphics card.
        self.evaluate(
            "document.querySelectorAll('.mantine-Notification-root').forEach(n => n.remove());"
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        self._process.communicate()
        self._profile.cleanup()
