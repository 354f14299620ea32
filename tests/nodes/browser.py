"""Debian's Chromium without a screen, driven through its DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from websockets.sync.client import ClientConnection, connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--remote-debugging-port=0", "--window-size=960,600", "--disable-dev-shm-usage", "about:blank"),
)


class Tab:
    """One tab: calls, and what its console has said."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._number = 0
        self.errors: list[str] = []
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Result of a DevTools method."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(answer["params"])[:500])
            elif answer.get("method") == "Runtime.consoleAPICalled" and answer["params"]["type"] == "error":
                self.errors.append(str(answer["params"]["args"][0].get("value")))
            if answer.get("id") == self._number:
                return answer["result"]

    def shows(self, words: str, seconds: float = 30.0) -> bool:
        """Whether the page shows `words`, now or some seconds later."""
        return self._comes_true(f"document.body.innerText.includes({json.dumps(words)})", seconds)

    def press(self, label: str) -> bool:
        """Clicks the button with this text, once it is there; whether it came."""
        button = f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() === {json.dumps(label)})"
        return self._comes_true(f"({button}?.click(), !!{button})", 30.0)

    def _comes_true(self, condition: str, seconds: float) -> bool:
        poll = (
            f"new Promise(done => {{ const end = Date.now() + {1000 * seconds}; const look = () => {{ "
            f"const is = {condition}; is || Date.now() > end ? done(is) : setTimeout(look, 50) }}; look() }})"
        )
        answer = self.call("Runtime.evaluate", expression=poll, awaitPromise=True, returnByValue=True)
        return bool(answer["result"]["value"])

    def click_middle(self) -> None:
        """Clicks at the middle of what is drawn in 3D."""
        box = self._canvas()
        self._click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def _click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def slide(self, share: float) -> None:
        """Clicks at a share of the way along the page's first slider."""
        find = "JSON.stringify(document.querySelector('[role=slider]').parentElement.getBoundingClientRect())"
        box = json.loads(self.call("Runtime.evaluate", expression=find, returnByValue=True)["result"]["value"])
        self._click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)

    def picture(self) -> NDArray[np.uint8]:
        """[H, W, 3] RGB of what the page draws in 3D, without the panels."""
        clip = {**self._canvas(), "scale": 1.0}
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png", clip=clip)["data"])
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)

    def _canvas(self) -> dict[str, float]:
        find = "JSON.stringify(document.querySelector('canvas').getBoundingClientRect())"
        box = json.loads(self.call("Runtime.evaluate", expression=find, returnByValue=True)["result"]["value"])
        return {side: box[side] for side in ("x", "y", "width", "height")}

    def screenshot(self, path: Path) -> None:
        """Writes a PNG of the window."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def open_tab(url: str) -> Iterator[Tab]:
    """A browser with one tab at `url`, ended with the context."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [CHROMIUM, f"--user-data-dir={profile}", *FLAGS]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        try:
            assert process.stderr is not None
            address = next(line.split()[-1] for line in process.stderr if line.startswith("DevTools listening on "))
            with connect(address, max_size=None) as browser:
                browser.send(json.dumps({"id": 1, "method": "Target.createTarget", "params": {"url": url}}))
                target = _result(browser, 1)["targetId"]
            with connect(f"{address.split('/devtools')[0]}/devtools/page/{target}", max_size=None) as socket:
                yield Tab(socket)
        finally:
            process.kill()
            process.wait()


def _result(socket: ClientConnection, number: int) -> Any:
    while True:
        answer = json.loads(socket.recv(timeout=60))
        if answer.get("id") == number:
            return answer["result"]
