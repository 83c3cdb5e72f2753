"""The page of a results folder as a reader has it: in a headless Chromium, or parsed without a browser.

Chromium is driven over a pipe in its own DevTools protocol: no driver program, no socket, no port.

The protocol's messages are JSON ended by a zero byte, on file descriptors 3 (to the browser) and 4 (from it). Selenium would
bring a second program that must match the browser's version, and not show requests or the console without this protocol.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = """
--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-dev-shm-usage --disable-gpu-compositing
--disable-gpu-rasterization --remote-debugging-pipe --no-first-run --disable-extensions --disable-component-update
--disable-background-networking --disable-sync --hide-scrollbars --mute-audio --window-size=1280,900
""".split()

HOSTILE = """<script>window.hacked=1</script> "x" & </script><!--"""
"""A name that would run, or break the page, if it were taken for anything but text."""


def chromium() -> str | None:
    """Return the path of a Chromium, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One browser with one page; `events` are all messages that answer no call."""

    def __init__(self, profile: Path) -> None:
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()

        def descriptors() -> None:
            os.dup2(to_read, 3 + 100)
            os.dup2(to_write, 4 + 100)
            os.dup2(103, 3)
            os.dup2(104, 4)

        command = [str(chromium()), *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        quiet = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        own: dict[str, Any] = {"preexec_fn": descriptors, "close_fds": False}
        self._process = subprocess.Popen(command, **quiet, **own, start_new_session=True)
        os.close(to_read)
        os.close(to_write)
        self._buffer, self._number, self._session = b"", 0, None
        self.events: list[dict[str, Any]] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t for t in targets if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, timeout_s: float = 60.0, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + timeout_s
        while True:
            answer = self._message(end)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def _message(self, end: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._read], [], [], max(0.0, end - time.monotonic()))[0]:
                raise TimeoutError("the browser does not answer")
            data = os.read(self._read, 1 << 20)
            if not data:
                raise RuntimeError("the browser has ended")
            self._buffer += data
        text, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(text)

    def open(self, path: Path, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Open a file in a window of this size and wait until it is loaded."""
        self.events.clear()
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=path.as_uri())
        self.until("document.readyState === 'complete'")

    def js(self, expression: str) -> Any:
        """The value of an expression in the page; promises are awaited."""
        how = {"returnByValue": True, "awaitPromise": True}
        done = self.call("Runtime.evaluate", expression=expression, **how)
        if "exceptionDetails" in done:
            wrong = done["exceptionDetails"]
            raise RuntimeError(wrong.get("exception", {}).get("description", "") or str(wrong))
        return done["result"].get("value")

    def until(self, condition: str, timeout_s: float = 30.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + timeout_s
        while True:
            with contextlib.suppress(RuntimeError):
                if self.js(condition) is True:
                    return
            if time.monotonic() > end:
                raise TimeoutError(condition)
            time.sleep(0.05)

    def show(self, selector: str, drawn: bool = True) -> None:
        """Bring an element into the window and, for a plot, wait until it is drawn."""
        element = f"document.querySelector({json.dumps(selector)})"
        self.js(f"{element}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
        if drawn:
            self.until(f"{element}.dataset.drawn === 'yes'")

    def key(self, key: str) -> None:
        """Press and release a key."""
        codes = {"Tab": 9, "ArrowLeft": 37, "ArrowRight": 39, "Enter": 13, " ": 32}
        pressed = {"key": key, "windowsVirtualKeyCode": codes.get(key, 0)}
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", **pressed, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **pressed)

    def requests(self) -> list[str]:
        """Addresses that the page has asked for."""
        sent = [e for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [e["params"]["request"]["url"] for e in sent]

    def complaints(self) -> list[str]:
        """Errors and warnings of the console, exceptions, entries of the log."""
        complaints = []
        for e in self.events:
            p = e.get("params", {})
            if e.get("method") == "Runtime.exceptionThrown":
                thrown = p["exceptionDetails"].get("exception", {})
                complaints.append(thrown.get("description", str(p)))
            if e.get("method") == "Runtime.consoleAPICalled" and p["type"] in ("error", "assert"):
                complaints.append(str([a.get("value", a.get("description")) for a in p["args"]]))
            if e.get("method") == "Log.entryAdded" and p["entry"]["level"] == "error":
                complaints.append(p["entry"]["text"])
        return complaints

    def close(self) -> None:
        """End the browser that was started here."""
        with contextlib.suppress(Exception):
            self.call("Browser.close", timeout_s=5)
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._write)
        os.close(self._read)


class Page(HTMLParser):
    """A page without a browser: elements by tag, text outside of scripts, content of the data element."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.data = ""
        self._in: str | None = None
        self._button = False
        self._sections: dict[str, list[str]] = {}
        self._open: list[str] = []
        self._buttons: list[str] = []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._in = tag if tag in ("script", "style") else None
        self._kind = dict(attrs).get("id")
        if tag == "section":
            self._open.append(self._kind or "")
        self._button = tag == "button" and "data-filter" in dict(attrs)

    def handle_endtag(self, tag):
        self._in, self._button = None, False
        if tag == "section" and self._open:
            self._open.pop()

    def handle_data(self, data):
        if self._in is None:
            self.words.append(data)
            if self._open:
                self._sections.setdefault(self._open[-1], []).append(data)
            if self._button:
                self._buttons.append(" ".join(data.split()))
        elif self._in == "script" and self._kind == "data":
            self.data += data

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def part(self, section: str) -> str:
        """The text of the section with this id."""
        return " ".join(" ".join(self._sections[section]).split())

    def buttons(self) -> list[str]:
        """Labels of the buttons that filter rows."""
        return self._buttons

    def ids(self, tag: str) -> list[str]:
        return [attrs["id"] for name, attrs in self.tags if name == tag and attrs.get("id")]
