"""A Chromium without a screen and without a network, driven by its own protocol over a pair of pipes."""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from select import select
from typing import Any

from ros_helpers import skip

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-extensions", "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND", "--remote-debugging-pipe",
)  # fmt: skip
_PATIENCE = 60.0


class Browser:
    """One page of a Chromium.

    Attributes
    ----------
    console : list of str
        What scripts wrote as a warning or an error, and what they threw.
    requests : list of str
        Addresses that were asked for, but for data that a page carries itself.
    """

    def __init__(self, process: subprocess.Popen[bytes], to: int, back: int) -> None:
        self._process, self._to, self._back = process, to, back
        self._rest, self._count, self._session = b"", 0, ""
        self.console: list[str] = []
        self.requests: list[str] = []
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")

    def size(self, width: int, height: int, phone: bool = False) -> None:
        """Show pages in a window of so many CSS pixels."""
        self._ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone
        )  # fmt: skip
        self._ask("Emulation.setTouchEmulationEnabled", enabled=phone)

    def scheme(self, wanted: str) -> None:
        """Ask pages to be ``light`` or ``dark``."""
        self._ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": wanted}])

    def open(self, page: Path, part: str = "") -> None:
        """Show a page and wait until it says that its charts are drawn."""
        self._ask("Page.navigate", url="about:blank")
        self._ask("Page.navigate", url=page.as_uri() + part)
        here = f"location.href.startsWith({json.dumps(page.as_uri())})"
        self.wait(f"{here} && document.documentElement?.dataset.drawn !== undefined")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + _PATIENCE
        while not self.value(condition):
            assert time.monotonic() < end, f"never came true: {condition}; console: {self.console}"
            time.sleep(0.05)

    def value(self, expression: str) -> Any:
        """What a JavaScript expression evaluates to."""
        answer = self._ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def picture(self, whole: bool = True) -> bytes:
        """The page as PNG: all of it, or what the window shows."""
        answer = self._ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole, **self._clip(whole))
        return base64.b64decode(answer["data"])

    def printed(self) -> bytes:
        """The page as PDF, on A4."""
        answer = self._ask("Page.printToPDF", paperWidth=8.27, paperHeight=11.69, printBackground=True)
        return base64.b64decode(answer["data"])

    def _clip(self, whole: bool) -> dict[str, Any]:
        if not whole:
            return {}
        size = self._ask("Page.getLayoutMetrics")["cssContentSize"]
        return {"clip": {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}}

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its answer; events on the way are noted."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, f"{method}: {answer['error']}"
                found: dict[str, Any] = answer["result"]
                return found
            self._note(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select([self._back], [], [], _PATIENCE)
            data = os.read(self._back, 1 << 20) if ready else b""
            assert data, f"the browser is silent; its exit status is {self._process.poll()}"
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        return message

    def _note(self, event: dict[str, Any]) -> None:
        method, about = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = about["exceptionDetails"]
            self.console.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning", "assert"):
            self.console.append(" ".join(str(a.get("value", a.get("description"))) for a in about["args"]))
        elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
            self.console.append(about["entry"]["text"])
        elif method == "Network.requestWillBeSent" and not about["request"]["url"].startswith(("data:", "blob:")):
            self.requests.append(about["request"]["url"])


@contextlib.contextmanager
def browser(profile: Path, *options: str) -> Iterator[Browser]:
    """A browser with a profile of its own and further options of its command line.

    The test is skipped, in CI failed, where none is installed.
    """
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        skip(f"no browser ({', '.join(BROWSERS)}) is installed; as root: apt-get install chromium")
    pipes = [os.pipe(), os.pipe()]
    reads, writes = (fcntl.fcntl(fd, fcntl.F_DUPFD, 30) for fd in (pipes[0][0], pipes[1][1]))
    start = [
        "bash",
        "-c",
        f'exec "$@" 3<&{reads} 4>&{writes}',
        "bash",
        found,
        *_OPTIONS,
        *options,
        f"--user-data-dir={profile}",
    ]
    with open(profile.with_suffix(".log"), "wb") as log:
        process = subprocess.Popen(start, pass_fds=(reads, writes), stdout=log, stderr=log, start_new_session=True)
    for fd in (reads, writes, pipes[0][0], pipes[1][1]):
        os.close(fd)
    to, back = pipes[0][1], pipes[1][0]
    try:
        opened = Browser(process, to, back)
        yield opened
        opened._session = ""
        with contextlib.suppress(AssertionError, OSError):
            opened._ask("Browser.close")
        process.wait(20)
    finally:
        process.kill()
        process.wait()
        os.close(to)
        os.close(back)
