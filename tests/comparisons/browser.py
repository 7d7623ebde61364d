"""A headless Chromium that shows a page, with what it made of it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


def look(url: str, profile: Path, *arguments: str, size: str = "1200,900") -> str:
    """The document as the browser has it once the script has run; skips without a browser."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    done = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
         "--no-first-run", "--disable-background-networking", "--disable-component-update",
         "--disable-sync", f"--user-data-dir={profile}", "--virtual-time-budget=2000",
         f"--window-size={size}", *(arguments or ("--dump-dom",)), url],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )  # fmt: skip
    return done.stdout


def came_up(dom: str) -> bool:
    """Whether the page's script ran to its end."""
    return 'data-ready="yes"' in dom.split("<head", 1)[0]
