"""The built pages in a headless Chromium: wide and narrow, light and dark."""

import functools
import html
import http.server
import json
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.comparisons.browser import browse, look

pytestmark = [pytest.mark.browser, pytest.mark.slow]
WIDTHS = (1400, 390)
LOOK = """
<!doctype html><meta charset="utf-8"><body style="margin:0"><script>
const found = [], wait = ms => new Promise(done => setTimeout(done, ms));
const canvas = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
function rgba(colour) {  // of any notation, by painting it
  canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
  const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
  return [r, g, b, a / 255];
}
const over = (top, below) => below.map((x, i) => i === 3 ? 1 : top[3] * top[i] + (1 - top[3]) * x);
const light = colour => colour.slice(0, 3).map(x => x / 255)
  .map(x => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4)
  .reduce((sum, x, i) => sum + [0.2126, 0.7152, 0.0722][i] * x, 0);
function behind(element, view) {
  const layers = [];
  for (let one = element; one; one = one.parentElement)
    layers.push(rgba(view.getComputedStyle(one).backgroundColor));
  return layers.reverse().reduce((below, top) => over(top, below), [255, 255, 255, 1]);
}
function contrast(element, view) {
  const below = behind(element, view);
  const pair = [light(over(rgba(view.getComputedStyle(element).color), below)), light(below)];
  return (Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05);
}
const TEXT = 'p, li, td, th, h1, h2, h3, a:not(.headerlink), code, pre code span';
async function look(page, width) {
  const frame = document.createElement('iframe');
  frame.style = `width:${width}px;height:900px;border:0`;
  const loaded = new Promise(done => { frame.onload = done; });
  frame.src = page;
  document.body.replaceChildren(frame);
  await loaded; await wait(100);
  const view = frame.contentWindow, doc = view.document, root = doc.documentElement;
  doc.head.append(Object.assign(doc.createElement('style'),
    { textContent: '* { transition: none !important; }' }));
  const say = what => found.push(`${page} ${width}: ${what}`);
  if (root.scrollWidth > view.innerWidth) say(`${root.scrollWidth} px wide`);
  for (const { name } of view.performance.getEntriesByType('resource'))
    if (!name.startsWith(location.origin) && !name.startsWith('data:')) say(`loads ${name}`);
  for (const picture of doc.querySelectorAll('article img'))
    if (!picture.complete || !picture.naturalWidth) say(`no picture ${picture.src}`);
  for (const table of doc.querySelectorAll('article table')) {
    let box = table;
    while (box.tagName !== 'ARTICLE'
           && !['auto', 'scroll'].includes(view.getComputedStyle(box).overflowX))
      box = box.parentElement;
    const wide = table.getBoundingClientRect().right > view.innerWidth + 1;
    if (wide && box.tagName === 'ARTICLE') say('a table is cut off');
  }
  for (const scheme of ['default', 'slate']) {
    doc.body.setAttribute('data-md-color-scheme', scheme);
    await wait(50);
    const poor = new Map();
    for (const one of [...doc.querySelectorAll(`article :is(${TEXT})`)].slice(0, 400)) {
      const own = [...one.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
      const ratio = own ? contrast(one, view) : 21;
      if (ratio < 4.5) poor.set(`${one.tagName} ${one.className}`, ratio);
    }
    for (const [what, ratio] of poor) say(`${scheme}: contrast ${ratio.toFixed(2)} of ${what}`);
  }
}
(async () => {
  for (const page of PAGES) for (const width of WIDTHS) await look(page, width);
  const out = document.createElement('pre');
  out.id = 'found'; out.textContent = JSON.stringify(found);
  document.body.replaceChildren(out);
})();
</script>
"""
"""Opens each page in a frame (a window is never narrower than 500 pixels) and notes faults."""


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serves files and says nothing."""

    def log_message(self, *_: Any) -> None:
        """Nothing."""


def served(folder: Path) -> Iterator[str]:
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


def faults(folder: Path, pages: list[str], profile: Path) -> list[str]:
    """What is wrong with pages in a folder, by a browser that reaches nothing but this machine."""
    look = LOOK.replace("PAGES", json.dumps(pages), 1).replace("WIDTHS", json.dumps(WIDTHS), 1)
    (folder / "look.html").write_text(look, encoding="utf-8")
    for address in served(folder):
        alone = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
        shown = ("--enable-logging=stderr", "--window-size=1500,1000", "--dump-dom")
        page, budget_ms = f"{address}/look.html", 4000 * len(pages) + 4000
        done = browse(page, profile, alone, *shown, budget_ms=budget_ms)
    (folder / "look.html").unlink()
    noted = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert noted is not None, done.stdout[-2000:] + done.stderr[-2000:]
    said = re.findall(r"CONSOLE[^\]]*\] (.*)", done.stderr)
    return [*json.loads(html.unescape(noted[1])), *said]


def test_pages_are_sound_wide_and_narrow_light_and_dark(site: Path, tmp_path: Path) -> None:
    pages = sorted(page.name for page in site.glob("*.html") if page.stem != "404")
    assert faults(site, pages, tmp_path) == []


def test_a_poor_page_is_found(tmp_path: Path) -> None:
    (tmp_path / "poor.html").write_text(
        "<body style='background:#fff'><article><p style='color:#aaa'>pale</p>"
        "<div style='width:2000px'>wide</div><img src='none.png'>"
        "<table><tr><td style='min-width:2000px'>cut</td></tr></table></article>"
        "<script src='https://cdn.example/x.js'></script><script>nothing.here</script>"
    )
    found = "\n".join(faults(tmp_path, ["poor.html"], tmp_path / "profile"))
    for what in ("2014 px wide", "contrast 2.32 of P", "no picture", "a table is cut off",
                 "nothing is not defined", "loads https://cdn.example/x.js"):  # fmt: skip
        assert what in found


def results_of(word: str, site: Path, profile: Path) -> list[str]:
    """Return the pages that a search lists, in a site that is opened as files, without a server."""
    dom = look(f"{(site / 'install.html').as_uri()}?q={word}", profile)
    links = re.findall(r'href="([^"]+)" class="md-search-result__link"', dom)
    return [link.rpartition("/")[2].partition("#")[0] for link in links]


def test_search_works_from_a_file(site: Path, tmp_path: Path) -> None:
    pages = results_of("whiteness", site, tmp_path)
    assert {"concepts.html", "result-schema.html"} <= set(pages)
    assert results_of("nosuchwordatall", site, tmp_path) == []


def test_a_search_lists_pages_that_explain_before_results(site: Path, tmp_path: Path) -> None:
    pages = results_of("optimism", site, tmp_path)
    assert pages.index("concepts.html") < pages.index("results-real-logs.html")


def test_without_a_frame_for_the_worker_a_file_has_no_search(site: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "site")
    (tmp_path / "site" / "iframe-worker.js").write_text("")
    assert results_of("whiteness", tmp_path / "site", tmp_path / "profile") == []
