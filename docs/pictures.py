"""Run the tutorials' commands; write what they print and their pictures into the pages.

    python docs/pictures.py [PAGE ...]     # `make pictures`; without pages, all of PICTURES

A page's `console` blocks hold its commands, behind `$`. They run in the page's order, in an empty
folder beside which `examples` is the project's. What a command prints replaces what the page
shows, long outputs and wall times cut out (`...`). tests/test_tutorials.py runs the same commands
and compares. Screenshots need Chromium.
"""

from __future__ import annotations

import functools
import http.server
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from PIL import Image, ImageChops

DOCS = Path(__file__).resolve().parent
PICTURES = {
    "first-run": {
        "report-top.png": "first/report.html",
        "report-curves.png": "first/report.html#time=60&layer=variance%20ratio%2C%20least@where",
        "first-run-map.png": "first/map.png",
        "first-run-consistency.png": "first/consistency.png",
        "first-run-disagree.png": "second/report.html",
    },
    "your-own-log": {},
    "dense-maps": {
        "dense-maps-map.png": "map/map.png",
        "dense-maps-check.png": "dense/dense.png",
    },
    "scans": {"scans-map.png": "scans/map.png", "scans-motion.png": "motion/map.png"},
    "monte-carlo": {"monte-carlo-curves.png": "study/curves.png"},
    "audit": {"audit.png": "slamcheck-audit-bug/report.html"},
}
"""Pages, their pictures, and what each shows: an image or a page of the commands' folders.

Behind `@` stands the id of the element that the picture of a page begins with; it is TALL.
"""
TALL = 1250
"""Pixels of a picture that begins within a page: a map, and curves below it."""
FIRST, LAST = 12, 16
"""Lines that a page shows of a long output: a verdict's first cause; its gaps and figures."""
LEAST = 6
"""Lines that are cut out, where any are."""
WIDTH = 1100
"""Most pixels of a picture's width."""
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
_BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_TIMES = re.compile(r"^seconds.*\n(?: .*\n)*", re.MULTILINE)


def commands(page: str) -> list[str]:
    """Return the commands of a page's text, in order."""
    return [c for block in _BLOCK.findall(page) for c in re.findall(r"^\$ (.*)$", block, re.M)]


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a page's command in a folder, with this interpreter's programs first on the path."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)))
    return subprocess.run(  # noqa: S603
        ["bash", "-c", command],  # noqa: S607
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": path, "HOME": str(folder), "OPENBLAS_NUM_THREADS": "1", "LC_ALL": "C.UTF-8"},
        timeout=300,
    )


def prepare(folder: Path) -> Path:
    """Make the folder that a page's commands run in."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "examples").symlink_to(DOCS.parent / "examples")
    return folder


def shortened(output: str) -> str:
    """Return what a page shows of an output: without wall times, long ones cut."""
    timeless = re.sub(r"[\d,.]+ scans/s", "... scans/s", _TIMES.sub("", output))
    kept = [line.rstrip() for line in timeless.splitlines()]
    if len(kept) >= FIRST + LAST + LEAST:
        kept = [*kept[:FIRST], "...", *kept[-LAST:]]
    return "".join(f"{line}\n" for line in kept)


def rewritten(page: str, folder: Path) -> str:
    """Return a page's text with the outputs of its commands, which run in a folder."""

    def block(found: re.Match[str]) -> str:
        parts = []
        for command in commands(found[0]):
            done = run(command, folder)
            if done.returncode not in (0, 1, 3):
                raise SystemExit(f"{command}: exit code {done.returncode}\n{done.stderr}")
            parts.append(f"$ {command}\n{shortened(done.stdout)}")
        return "```console\n" + "".join(parts) + "```"

    return _BLOCK.sub(block, page)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Log nothing."""


FRAME = """<!doctype html><body style="margin:0"><iframe src="{page}" onload="setTimeout(() => {{
const one = '{element}' && this.contentDocument.getElementById('{element}');
if (one) one.scrollIntoView(); }}, 500)" style="border:0;width:100vw;height:100vh"></iframe>"""


def shot(folder: Path, page: str, height: int) -> Image.Image:
    """Return the picture of a page of a folder, from a headless browser.

    The page comes from a local server: opened as a file, a report shows the path of its folder.
    Raises SystemExit without a browser.
    """
    browser = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if browser is None:
        raise SystemExit("pictures of pages need Chromium")
    address, _, element = page.partition("@")
    (folder / "shot.html").write_text(FRAME.format(page=address, element=element), encoding="utf-8")
    handler = functools.partial(_Quiet, directory=str(folder))
    with (
        tempfile.TemporaryDirectory() as work,
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server,
    ):
        threading.Thread(target=server.serve_forever).start()
        target = Path(work) / "shot.png"
        try:
            subprocess.run(  # noqa: S603
                [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                 f"--user-data-dir={work}/profile", "--virtual-time-budget=6000",
                 f"--window-size=1200,{height}", f"--screenshot={target}",
                 f"http://127.0.0.1:{server.server_port}/shot.html"],
                capture_output=True, check=True, timeout=120,
            )  # fmt: skip
        finally:
            server.shutdown()
        return Image.open(io.BytesIO(target.read_bytes())).convert("RGB")


def write_picture(image: Image.Image, path: Path) -> None:
    """Write an image small: no margin, at most WIDTH pixels wide, 128 colours."""
    image = image.convert("RGB")
    blank = Image.new("RGB", image.size, image.getpixel((0, 0)) or 0)
    box = ImageChops.difference(image, blank).getbbox()
    if box is not None:
        left, top, right, bottom = box
        image = image.crop(
            (max(left - 12, 0), max(top - 12, 0), min(right + 12, image.width),
             min(bottom + 12, image.height))
        )  # fmt: skip
    if image.width > WIDTH:
        image = image.resize((WIDTH, image.height * WIDTH // image.width), Image.Resampling.LANCZOS)
    image.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


def main(names: list[str]) -> None:
    """Write pages and their pictures anew."""
    for name in names or PICTURES:
        page = DOCS / f"{name}.md"
        with tempfile.TemporaryDirectory() as work:
            folder = prepare(Path(work) / name)
            page.write_text(rewritten(page.read_text(encoding="utf-8"), folder), encoding="utf-8")
            for target, source in PICTURES[name].items():
                is_page = ".html" in source
                high = TALL if "@" in source else 900
                image = shot(folder, source, high) if is_page else Image.open(folder / source)
                write_picture(image, DOCS / target)
        print(f"{name}: {', '.join(PICTURES[name]) or 'no pictures'}")


if __name__ == "__main__":
    main(sys.argv[1:])
