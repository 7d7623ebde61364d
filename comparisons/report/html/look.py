"""Style and script of the page, and the policy under which a browser accepts no others."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files

_SCRIPTS = ("common.js", "map.js", "curves.js", "tables.js")


def style() -> str:
    """The page's only style sheet."""
    return _text("page.css")


def script(names: Sequence[str] = _SCRIPTS) -> str:
    """The page's only script: its parts, each a function of its own, in order."""
    parts = "\n".join(_text(name) for name in names)
    return f"'use strict';\n{parts}\ndocument.documentElement.dataset.ready = 'yes';\n"


def policy(style_text: str, script_text: str) -> str:
    """Nothing is loaded, and nothing runs but these two; without a script, none."""
    script_source = f"script-src '{_hash(script_text)}'; " if script_text else ""
    return f"default-src 'none'; style-src '{_hash(style_text)}'; {script_source}img-src data:"


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _text(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")
