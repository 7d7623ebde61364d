"""Style, colours and script of the page, and the policy under which a browser takes no others."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from importlib.resources import files

_SCRIPTS = ("common.js", "map.js", "curves.js", "tables.js", "folder.js")
DARK: Mapping[str, str] = {
    "#00798c": "#3fb6c8",
    "#1b3a4b": "#9cc0d4",
    "#2a7d4f": "#5cb585",
    "#2e7d32": "#6dbf73",
    "#333333": "#c4c4c4",
    "#3a6ea5": "#6f9fd8",
    "#444444": "#b5b5b5",
    "#5b7c8d": "#7fa6ba",
    "#5c6f2b": "#a3b765",
    "#666666": "#a6a6a6",
    "#6a3d9a": "#b18be0",
    "#6a4c93": "#a78bd6",
    "#7b4fa3": "#bb93e6",
    "#8f5d2b": "#c99a68",
    "#b05f9e": "#d68cc5",
    "#d1495b": "#f0788a",
}
"""Colours of lines that are hard to see on a dark page, and what they are there."""


def style() -> str:
    """The page's only style sheet."""
    dark = "".join(f"{_variable(light)}:{colour};" for light, colour in DARK.items())
    return f"{_text('page.css')}@media screen and (prefers-color-scheme: dark){{:root{{{dark}}}}}"


def themed(colour: str) -> str:
    """Return a colour as the page writes it: the same on white, lighter on a dark page."""
    return f"var({_variable(colour)}, {colour})" if colour in DARK else colour


def script(names: Sequence[str] = _SCRIPTS) -> str:
    """The page's only script: its parts, each a function of its own, in order."""
    parts = "\n".join(_text(name) for name in names)
    return f"'use strict';\n{parts}\ndocument.documentElement.dataset.ready = 'yes';\n"


def policy(style_text: str, script_text: str) -> str:
    """Nothing is loaded, and nothing runs but these two; without a script, none."""
    script_source = f"script-src '{_hash(script_text)}'; " if script_text else ""
    return f"default-src 'none'; style-src '{_hash(style_text)}'; {script_source}img-src data:"


def _variable(colour: str) -> str:
    return f"--c{colour.removeprefix('#')}"


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _text(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")
