"""A headless Chromium that shows a page, with what it made of it."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

_POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')


def browse(
    url: str, profile: Path, *arguments: str, budget_ms: int = 2000
) -> subprocess.CompletedProcess[str]:
    """Have a browser show a page for some of its own time; skips without a browser."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    return subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
         "--no-first-run", "--disable-background-networking", "--disable-component-update",
         "--disable-sync", f"--user-data-dir={profile}", f"--virtual-time-budget={budget_ms}",
         *arguments, url],
        capture_output=True,
        text=True,
        check=False,
        timeout=400,
    )  # fmt: skip


def look(url: str, profile: Path, *arguments: str, size: str = "1200,900") -> str:
    """The document as the browser has it once the script has run; skips without a browser."""
    return browse(url, profile, f"--window-size={size}", *(arguments or ("--dump-dom",))).stdout


def noted(
    page: Path, folder: Path, steps: str, *, width: int = 1200, dark: bool = False
) -> dict[str, Any]:
    """What script that acts as a reader would writes into `noted`, on a page of so many pixels.

    steps: run in the page once its own script has run, without its policy. The page stands in a
    frame, for a window is never narrower than 500 pixels.
    """
    text = _POLICY.sub("", page.read_text(encoding="utf-8"))
    send = "parent.postMessage(JSON.stringify(noted), '*');"
    run = f"<script>(async () => {{ const noted = {{}}; {steps} {send} }})();</script>"
    (folder / "framed.html").write_text(text.replace("</body>", f"{run}</body>"), encoding="utf-8")
    outer = folder / "frame.html"
    outer.write_text(
        "<body><script>addEventListener('message', e => { document.body.dataset.noted = e.data; });"
        f"</script><iframe src='framed.html' style='width:{width}px;height:900px;border:0'>",
        encoding="utf-8",
    )
    scheme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    size = f"{max(width, 500)},900"
    dom = look(outer.as_uri(), folder / "profile", scheme, "--dump-dom", size=size)
    found = re.search(r'data-noted="([^"]*)"', dom)
    assert found is not None, "the page's script did not run to its end"
    return dict(json.loads(html.unescape(found[1])))


def came_up(dom: str) -> bool:
    """Whether the page's script ran to its end."""
    return 'data-ready="yes"' in dom.split("<head", 1)[0]
