"""The page in a real browser: a click on the body cuts it, undo brings it back, and the browser finds nothing to complain of."""

import contextlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest

viser = pytest.importorskip("viser")
playwright = pytest.importorskip("playwright.sync_api")

from agents.page import PageError, ViewOptions, serve  # noqa: E402
from agents.page_loop import new_file  # noqa: E402
from agents.recording import read_recording  # noqa: E402

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""A browser of this machine's own."""
FLAGS = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
         ]  # fmt: skip
"""WebGL without a graphics card, and no talk with anybody else."""
HARMLESS = re.compile(r"THREE\.Clock: This module|GPU stall due to ReadPixels|Automatic fallback to software WebGL")
"""What the viewer's own libraries are warned of."""
SIZE = {"width": 760, "height": 560}
"""Small: every pixel is drawn by the processor."""
BODY = (220, 310)
"""Where the middle of the body is drawn."""
PATIENCE = 60.0
"""How long a busy machine may take for one thing [s]."""

SERVE = "import sys; from pathlib import *; from agents.page import ViewOptions, serve; sys.exit(serve(ViewOptions(**{options})))"
"""A program that serves a page; a path reads as the class that it is made by."""


PRESS = """names => names.forEach(name => {
    const buttons = [...document.querySelectorAll("button")];
    buttons.find(button => button.innerText.trim() === name).click();
})"""
"""A script that presses buttons by their names, without a pause."""


@contextlib.contextmanager
def served(**options):
    """Serve a page from a process of its own and yield (its address, the process)."""
    program = SERVE.format(options={"scene": "box-48", "port": 0} | options)
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        yield re.search(r"the page is (http://127\.0\.0\.1:\d+); Ctrl-C ends it", line)[1], process
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def browsed(address):
    """Open an address in a browser and yield the page and what it had to say; skip where there is no browser."""
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine")
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(1e3 * PATIENCE)
        said = []
        page.on("console", lambda message: said.append((message.type, message.text)))
        page.on("pageerror", lambda error: said.append(("error", str(error))))
        page.goto(address)
        page.wait_for_selector("[data-reading=cuts]")
        yield page, said
        browser.close()


def reading(page, name):
    """Return what a read-out says."""
    return page.inner_text(f"[data-reading={name}]")


def wait_for(page, name, wanted):
    """Wait until a read-out says what is wanted."""
    script = "([name, wanted]) => document.querySelector(`[data-reading=${name}]`).innerText === wanted"
    page.wait_for_function(script, arg=[name, wanted])


def click_the_body(page):
    """Click the body until it is cut: the picture may not have been drawn yet."""
    until = time.monotonic() + PATIENCE
    while reading(page, "cuts") == "0" and time.monotonic() < until:
        page.mouse.click(*BODY)
        page.wait_for_timeout(1500)


def test_a_body_is_cut_by_a_click_brought_back_and_recorded(tmp_path):
    with served(recordings=tmp_path) as (address, process), browsed(address) as (page, said):
        assert reading(page, "cost").startswith("0.000") and reading(page, "tetrahedra") == "48"
        page.keyboard.press("t")
        click_the_body(page)
        cuts, cost = int(reading(page, "cuts")), reading(page, "cost")
        assert cuts >= 1 and not cost.startswith("0.000") and int(reading(page, "tetrahedra")) < 48
        for left in range(cuts - 1, -1, -1):
            page.keyboard.press("z")
            wait_for(page, "cuts", str(left))
        assert reading(page, "cost").startswith("0.000") and reading(page, "tetrahedra") == "48"
        page.get_by_text("Redo", exact=True).click()
        wait_for(page, "cuts", "1")
        page.get_by_text("Recording", exact=True).click()
        page.get_by_text("Save", exact=True).click()
        page.wait_for_selector("text=saved as")
        # Two buttons of one row, pressed in the same instant: both do what they say, in this order.
        page.evaluate(PRESS, ["Next", "Reset"])
        page.wait_for_selector("text=(2 of ")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    (path,) = tmp_path.iterdir()
    recording = read_recording(path)
    assert len(recording.actions) == 1 and recording.scene == "box-48" and recording.reason is None
    worst = [each for each in said if each[0] in ("error", "warning") and not HARMLESS.search(each[1])]
    # That the page has gone is found out by the browser too.
    assert [each for each in worst if "WebSocket" not in each[1] and "ERR_CONNECTION" not in each[1]] == []


# Without a browser ------------------------------------------------------------------------------------------------


def test_pages_of_other_sites_are_refused():
    connect = pytest.importorskip("websockets.sync.client").connect
    refused = pytest.importorskip("websockets.exceptions").InvalidStatus
    with served() as (address, _):
        socket_address, protocol = address.replace("http", "ws"), f"viser-v{viser.__version__}"
        with connect(socket_address, origin=address, subprotocols=[protocol]):
            pass
        with pytest.raises(refused, match="403"):
            connect(socket_address, origin="http://elsewhere.example", subprotocols=[protocol])


@pytest.mark.parametrize("name", ["../../outside/x", "box-48", ". .", "a/b"])
def test_a_recording_lies_in_its_folder_whatever_the_scene_is_called(name, tmp_path):
    folder = tmp_path / "recordings"
    for number in (1, 2):
        path = new_file(folder, name)
        assert path.parent == folder and path.name.endswith(f"-{number}.json") and path.exists()


def test_a_port_in_use_is_one_clear_error():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(PageError, match=f"port {port} of 127.0.0.1 is in use; end what uses it, or choose another"):
            serve(ViewOptions(scene="box-48", port=port))


@pytest.mark.parametrize(("address", "said"), [
    ({"port": 70000}, "there is no port 70000; give one from 1 to 65535"),
    ({"host": "203.0.113.1"}, "cannot serve at 203.0.113.1, port 0: .*; choose others"),
    ({"host": "no such host"}, "cannot serve at no such host, port 0"),
])  # fmt: skip
def test_an_address_that_cannot_be_served_at_is_one_clear_error(address, said):
    with pytest.raises(PageError, match=said):
        serve(ViewOptions(**{"scene": "box-48", "port": 0} | address))


def test_a_page_without_viser_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(Exception, match=r"the page needs viser: pip install 'gmapspring\[viewer\]'"):
        serve(ViewOptions(scene="box-48", port=0))
