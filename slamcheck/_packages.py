"""Whether slamcheck's packages are its own: other people's distributions use these names, too."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import Distribution

PACKAGES = ("comparisons", "ekf_reference", "graphslam")
MARK = '__part_of__ = "slamcheck"\n'
"""A line of each package's `__init__.py`; pip overwrites or removes that file without a word."""


@cache
def check_packages() -> None:
    """Check that Python finds slamcheck's own packages, and imports none of them.

    Raises:
        ImportError: another package has the name of one; in one line whose it is, where it lies,
            and the command that mends it.
    """
    home = Path(__file__).resolve().parents[1]
    for name in PACKAGES:
        ours, found = home / name / "__init__.py", _source(name)
        if found != ours or MARK not in found.read_text(encoding="utf-8", errors="replace"):
            raise ImportError(_fault(name, ours, found), name=name)


def _source(name: str) -> Path | None:
    """Return the file that `import name` would run, None where there is none."""
    spec = find_spec(name)
    return Path(spec.origin).resolve() if spec and spec.origin else None


def _fault(name: str, ours: Path, found: Path | None) -> str:
    """Return what stands in the way of a package, and how to mend it."""
    if found is None:
        return (
            f"{ours} is missing: another distribution with a package {name} was removed and took "
            f"it along; run: {_reinstall()}"
        )
    owner = _owner(name, found)
    whose = "another program's" if owner is None else f"of {owner.name} {owner.version}"
    fault = f"{found} is {whose} and hides slamcheck's package {name}; "
    if found != ours and owner is None:
        return f"{fault}rename it, or take its folder off Python's path (PYTHONPATH, sys.path)"
    commands = [] if owner is None else [f"pip uninstall --yes {owner.name}"]
    commands += [_reinstall()] if found == ours else []
    return f"{fault}run: {' && '.join(commands)}"


def _owner(name: str, found: Path) -> Distribution | None:
    """Return another distribution that has installed a package's first file."""
    from importlib.metadata import distributions

    for one in distributions():
        named = {file.as_posix() for file in one.files or ()} & {
            f"{name}/__init__.py",
            f"{name}.py",
        }
        places = {Path(str(one.locate_file(file))).resolve() for file in named}
        if one.name != "slamcheck" and found in places:
            return one
    return None


def _reinstall() -> str:
    """Return the command that installs slamcheck again from where it came."""
    import json
    import shlex
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import unquote

    try:
        this = distribution("slamcheck")
    except PackageNotFoundError:
        return "pip install --force-reinstall --no-deps SLAMCHECK'S FOLDER"
    url = json.loads(this.read_text("direct_url.json") or "{}").get("url")
    source = unquote(url).removeprefix("file://") if url else f"slamcheck=={this.version}"
    return f"pip install --force-reinstall --no-deps {shlex.quote(source)}"
