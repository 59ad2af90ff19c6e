"""A headless Chromium that tests drive: Debian's ``chromium``, with no network, over a pipe.

How to use it (``chromium()`` skips where there is none, and fails in CI)::

    with Browser(chromium(), seconds=60) as browser:
        browser.open(path)                        # a file; returns when it has loaded
        browser.evaluate("document.title")        # any JSON value; promises are awaited
        browser.wait("window.viewer !== null")    # until it is true
        before = browser.picture("#view")         # uint8 (height, width, 3), of what a selector
        browser.drag("#view", (-80, 30))          # finds, or of the window
        browser.focus("#view")
        browser.press("ArrowLeft")
        browser.click("#reset")
        assert not browser.complaints             # console errors and warnings, uncaught errors
        assert not browser.requests               # whatever was asked for besides data and blobs
        pdf = browser.pdf()                       # as bytes

One browser is for a module (a fixture with ``scope="module"``). ``open`` makes a fresh page and
forgets the complaints and requests of the one before. Whatever takes longer than ``seconds`` in all
raises ``TimeoutError``; the browser and its children end with the test, at that time at the latest.

It speaks the protocol of Chrome's developer tools, JSON between zero bytes, on descriptors 3 and 4
(``--remote-debugging-pipe``), so nothing listens anywhere. ``call`` sends any other command.
"""

import base64
import contextlib
import fcntl
import io
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--force-color-profile=srgb",
    "--hide-scrollbars",
    "--mute-audio",
)

CODES = {
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "Enter": 13,
    "Tab": 9,
    "Escape": 27,
    "Home": 36,
    "End": 35,
    " ": 32,
}
"""Numbers of keys that are no letters."""

SHIFT = 8
"""What the protocol calls this key among those that are held."""

BUTTONS = {"left": 1, "right": 2, "middle": 4}


def chromium():
    """Return the path of the browser; a machine without it skips, CI fails."""
    path = shutil.which("chromium")
    if path is None:
        missing = "chromium is not installed here"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    return path


class Browser:
    """Chromium with one page.

    Parameters
    ----------
    program
        Its path.
    seconds
        How long it may live.
    size
        Width and height of the window, in pixels of the page.
    flags
        More of them, such as ``--disable-3d-apis``.
    """

    def __init__(self, program, *, seconds=60.0, size=(1000, 800), flags=()):
        self.end = time.monotonic() + seconds
        self.size = size
        self.folder = tempfile.mkdtemp(prefix="browser-")
        self.complaints, self.requests, self.events = [], [], []
        self.target = self.session = None
        self._number, self._buffer, self._replies = 0, b"", {}
        profile = f"--user-data-dir={self.folder}"
        window = f"--window-size={size[0]},{size[1]}"
        guard = ["timeout", "-k", "1", f"{seconds:.0f}"]
        self._start([*_alone(), *guard, program, *FLAGS, *flags, profile, window, "about:blank"])

    def _start(self, command):
        ours_read, theirs_write = _pipe()
        theirs_read, ours_write = _pipe()
        said = os.open(Path(self.folder) / "said.txt", os.O_WRONLY | os.O_CREAT)
        actions = [
            (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
            *((os.POSIX_SPAWN_DUP2, said, stream) for stream in (1, 2)),
            (os.POSIX_SPAWN_DUP2, theirs_read, 3),
            (os.POSIX_SPAWN_DUP2, theirs_write, 4),
        ]
        self.process = os.posix_spawnp(
            command[0],
            command,
            {**os.environ, "HOME": self.folder},
            file_actions=actions,
            setsid=True,
        )
        for descriptor in (theirs_read, theirs_write, said):
            os.close(descriptor)
        self._read, self._write = ours_read, ours_write

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """End the browser and all that it has started."""
        if self.process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        self.process = None
        os.close(self._read)
        os.close(self._write)
        shutil.rmtree(self.folder, ignore_errors=True)

    def call(self, method, _session=True, **parameters):
        """Send a command and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if _session and self.session:
            message["sessionId"] = self.session
        text = json.dumps(message).encode() + b"\0"
        while text:
            text = text[os.write(self._write, text) :]
        number = self._number
        while number not in self._replies:
            self._receive()
        reply = self._replies.pop(number)
        if "error" in reply:
            raise RuntimeError(f"{method}: {reply['error']}")
        return reply["result"]

    def _receive(self):
        """Take in what the browser says next; wait for it, but no longer than it may live."""
        left = self.end - time.monotonic()
        if left <= 0 or not select.select([self._read], [], [], left)[0]:
            raise TimeoutError(f"the browser took too long\n{self._said()}")
        chunk = os.read(self._read, 1 << 20)
        if not chunk:
            raise RuntimeError(f"the browser has ended\n{self._said()}")
        *messages, self._buffer = (self._buffer + chunk).split(b"\0")
        for text in messages:
            message = json.loads(text)
            if "id" in message:
                self._replies[message["id"]] = message
            elif message.get("sessionId") == self.session:
                self._event(message["method"], message["params"])

    def _said(self):
        return (Path(self.folder) / "said.txt").read_text(errors="replace")[-2000:]

    def _event(self, name, given):
        self.events.append(name)
        if name == "Network.requestWillBeSent":
            url = given["request"]["url"]
            if url != self.page and not url.startswith(("data:", "blob:", "about:")):
                self.requests.append(url)
        elif name == "Runtime.exceptionThrown":
            details = given["exceptionDetails"]
            said = details.get("exception", {}).get("description", details["text"])
            self.complaints.append(said)
        elif name == "Runtime.consoleAPICalled" and given["type"] in {"error", "warning", "assert"}:
            words = [str(a.get("value", a.get("description"))) for a in given["args"]]
            self.complaints.append(" ".join(words))
        elif name == "Log.entryAdded" and given["entry"]["level"] in {"error", "warning"}:
            self.complaints.append(given["entry"]["text"])

    def open(self, path, query=""):
        """Open a file in a fresh page and return when it has loaded."""
        self._fresh()
        self.page = Path(path).resolve().as_uri() + query
        self.events.clear()
        self.complaints.clear()
        self.requests.clear()
        found = self.call("Page.navigate", url=self.page)
        if "errorText" in found:
            raise RuntimeError(f"{self.page}: {found['errorText']}")
        while "Page.loadEventFired" not in self.events:
            self._receive()

    def _fresh(self):
        self.page = "about:blank"
        if self.target:
            self.call("Target.closeTarget", _session=False, targetId=self.target)
        made = self.call("Target.createTarget", _session=False, url="about:blank")
        self.target = made["targetId"]
        found = self.call(
            "Target.attachToTarget", _session=False, targetId=self.target, flatten=True
        )
        self.session = found["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.resize(*self.size)

    def resize(self, width, height, ratio=1.0):
        """Give the page another size, and another ratio of the screen's pixels to its own."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=ratio,
            mobile=False,
        )

    def media(self, kind="", **features):
        """Pretend that the page is printed (``"print"``) or that a wish is set.

        Such as ``prefers_reduced_motion="reduce"``.
        """
        wishes = [{"name": k.replace("_", "-"), "value": v} for k, v in features.items()]
        self.call("Emulation.setEmulatedMedia", media=kind, features=wishes)

    def evaluate(self, expression):
        """Return what a JavaScript expression comes to, as JSON; raise what it throws."""
        found = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in found:
            details = found["exceptionDetails"]
            raise RuntimeError(details.get("exception", {}).get("description", details["text"]))
        return found["result"].get("value")

    def wait(self, expression):
        """Wait until a JavaScript expression is true."""
        while not self.evaluate(expression):
            if time.monotonic() > self.end:
                raise TimeoutError(f"this never came true: {expression}")
            time.sleep(0.02)

    def settle(self):
        """Wait until what has changed is on the screen."""
        self.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")

    def box(self, selector):
        """Return left, top, width and height of an element, scrolled into the window."""
        self.evaluate(
            f"document.querySelector({selector!r}).scrollIntoView({{block: 'nearest', "
            "behavior: 'instant'})"
        )
        return self.evaluate(
            f"(b => [b.left, b.top, b.width, b.height])"
            f"(document.querySelector({selector!r}).getBoundingClientRect())"
        )

    def screenshot(self, selector=None):
        """Return the PNG file of an element, or of the window."""
        self.settle()
        area = {}
        if selector is not None:
            left, top, width, height = self.box(selector)
            x, y = self.evaluate("[scrollX, scrollY]")
            clip = {"x": x + left, "y": y + top, "width": width, "height": height, "scale": 1}
            area = {"clip": clip}
        return base64.b64decode(self.call("Page.captureScreenshot", format="png", **area)["data"])

    def picture(self, selector=None):
        """Return the pixels of an element, or of the window: uint8 (height, width, 3)."""
        with Image.open(io.BytesIO(self.screenshot(selector))) as image:
            return np.array(image.convert("RGB"))

    def pdf(self, **options):
        """Return the page as it is printed."""
        return base64.b64decode(self.call("Page.printToPDF", **options)["data"])

    def _mouse(self, kind, at, **more):
        self.call("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], **more)

    def drag(self, selector, by, *, start=(0.5, 0.5), button="left", shift=False, steps=5):
        """Press the mouse in an element, move it ``by`` so many pixels, and let go.

        ``start`` is where, as a part of the element's width and height.
        """
        left, top, width, height = self.box(selector)
        at = (left + start[0] * width, top + start[1] * height)
        held = {"button": button, "modifiers": SHIFT if shift else 0}
        self._mouse("mouseMoved", at)
        self._mouse("mousePressed", at, clickCount=1, **held)
        for step in range(1, steps + 1):
            to = (at[0] + by[0] * step / steps, at[1] + by[1] * step / steps)
            self._mouse("mouseMoved", to, buttons=BUTTONS[button], **held)
        self._mouse("mouseReleased", to, clickCount=1, **held)

    def click(self, selector, *, count=1):
        """Click in the middle of an element, or double-click."""
        left, top, width, height = self.box(selector)
        at = (left + width / 2, top + height / 2)
        for number in range(1, count + 1):
            for kind in ("mousePressed", "mouseReleased"):
                self._mouse(kind, at, button="left", clickCount=number)

    def wheel(self, selector, by):
        """Turn the wheel over an element."""
        left, top, width, height = self.box(selector)
        self._mouse("mouseWheel", (left + width / 2, top + height / 2), deltaX=0, deltaY=by)

    def touch(self, selector, *strokes, steps=5):
        """Move fingers: each stroke goes from a point to another, in pixels from the middle."""
        left, top, width, height = self.box(selector)
        middle = np.array([left + width / 2, top + height / 2])
        ends = middle + np.array(strokes, float)

        def points(part):
            places = ends[:, 0] + (ends[:, 1] - ends[:, 0]) * part
            return [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places.tolist())]

        self.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=points(0))
        for step in range(1, steps + 1):
            at = points(step / steps)
            self.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=at)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def focus(self, selector):
        """Give an element the keyboard."""
        self.evaluate(f"document.querySelector({selector!r}).focus()")

    def press(self, key, *, shift=False):
        """Press a key: a letter, or a name as in ``KeyboardEvent.key``."""
        code = CODES.get(key, ord(key[0].upper()))
        text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
        given = {
            "key": key,
            "windowsVirtualKeyCode": code,
            "modifiers": SHIFT if shift else 0,
            **({"text": text} if text else {}),
        }
        self.call("Input.dispatchKeyEvent", type="keyDown", **given)
        self.call("Input.dispatchKeyEvent", type="keyUp", **given)


def _pipe():
    """Return both ends of a pipe, on descriptors above those that the browser is given."""
    ends = os.pipe()
    high = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in ends]
    for end in ends:
        os.close(end)
    return high


def _alone():
    """Return what stands before a command that has no network and ends with us, where it can."""
    words = []
    for guard in (["setpriv", "--pdeathsig", "KILL", "--"], ["unshare", "-n", "--"]):
        try:
            tried = subprocess.run(
                [*guard, "true"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=10,
                check=False,
            )
        except (OSError, subprocess.SubprocessError):
            continue
        words += guard if tried.returncode == 0 else []
    return words
