"""A browser without a window, led over a pipe: what it shows, and what it asks the network for."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from select import select
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-pipe",
)
ANSWER_S = 60.0
FRAMES = {"autoAttach": True, "waitForDebuggerOnStart": True, "flatten": True}
"""A frame of another site is in a process of its own, which waits until it is listened to."""


def browser_binary() -> str | None:
    """Return the browser of this machine, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@dataclass(slots=True)
class Browser:
    """One page; see the Chrome DevTools Protocol for the methods."""

    to: int
    back: int
    session: str = ""
    requests: dict[str, str] = field(default_factory=dict)
    """Address of every request, by its number."""
    refused: set[str] = field(default_factory=set)
    """Numbers of the requests that the page's policy did not let out."""
    _number: int = 0
    _rest: bytes = b""

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method and return its result; events that come meanwhile are noted."""
        number = self._ask(self.session, method, **parameters)
        for answer in self._messages(ANSWER_S):
            if answer.get("id") == number:
                result: dict[str, Any] = answer.get("result", {})
                return result
        raise TimeoutError(method)

    def _ask(self, session: str, method: str, **parameters: object) -> int:
        """Call a method of a page or frame and return the number of the call."""
        self._number += 1
        message: dict[str, object] = {"id": self._number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        return self._number

    def open(self, url: str) -> None:
        """Open an address in a page of its own."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Network.enable")
        self.call("Target.setAutoAttach", **FRAMES)
        self.call("Page.navigate", url=url)

    def photograph(self, path: Path) -> None:
        """Save what the page shows."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def listen(self, seconds: float) -> None:
        """Note events for a while."""
        for _ in self._messages(seconds):
            pass

    def gone_out(self, *local: str) -> list[str]:
        """Return the addresses that were asked for and begin with none of these, unless they were refused."""
        ours = (*local, "data:", "blob:", "about:", "chrome")
        return [
            url
            for number, url in self.requests.items()
            if not url.startswith(ours) and number not in self.refused
        ]

    def _messages(self, seconds: float) -> Iterator[dict[str, Any]]:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            while b"\0" in self._rest:
                one, _, self._rest = self._rest.partition(b"\0")
                message = json.loads(one)
                self._note(message)
                yield message
            if select([self.back], [], [], left)[0]:
                self._rest += os.read(self.back, 1 << 20)

    def _note(self, message: dict[str, Any]) -> None:
        details = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requests[details["requestId"]] = details["request"]["url"]
        elif message.get("method") == "Network.loadingFailed" and details.get("blockedReason") == "csp":
            self.refused.add(details["requestId"])
        elif message.get("method") == "Target.attachedToTarget":
            for method in ("Network.enable", "Runtime.runIfWaitingForDebugger"):
                self._ask(details["sessionId"], method)


@contextmanager
def browser(binary: str, size: str = "1456,819") -> Iterator[Browser]:
    """Start a browser with a window of this width and height, and end it."""
    there, to = os.pipe()
    back, here = os.pipe()
    with tempfile.TemporaryDirectory(prefix="imumon-", ignore_cleanup_errors=True) as profile:
        flags = " ".join([*FLAGS, f"--window-size={size}", f'"--user-data-dir={profile}"'])
        process = subprocess.Popen(
            ["bash", "-c", f'exec "{binary}" {flags} about:blank 3<&{there} 4>&{here}'],
            pass_fds=(there, here),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(there)
        os.close(here)
        try:
            yield Browser(to, back)
        finally:
            with suppress(BrokenPipeError):
                os.write(to, b'{"id": 0, "method": "Browser.close"}\0')
            with suppress(subprocess.TimeoutExpired):
                process.wait(5)
            process.kill()
            process.wait()
            os.close(to)
            os.close(back)
