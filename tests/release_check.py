"""`make release-check`: what is released, built, looked into, and used on every Python.

    python -m tests.release_check [--allow-missing] [PYTHON ...]

Without names it takes python3.11, python3.12 and python3.13 from PATH; a version that is not there
is a failure unless `--allow-missing` is given. Takes minutes, and a network for pip.
"""

import argparse
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("slamcheck", "ekf_reference", "graphslam", "comparisons")
BESIDE = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CITATION.cff", "CHANGELOG.md")
"""What a distribution is built from, beside the packages."""
PYTHONS = ("3.11", "3.12", "3.13")
USE = """
from pathlib import Path
import slamcheck
assert slamcheck.__version__ == {version!r}, slamcheck.__version__
log = slamcheck.load_log("simulated-loop", seed=7)
run = slamcheck.compare(log)
assert run.verdict.outcome == "agree", run
mine = Path("mine")
mine.mkdir()
slamcheck.write_estimate(run.ekf.estimate, mine)
assert slamcheck.check(log, mine).outcome == "agree"
print(repr(run))
"""
TEST = """
def test_filter(slam_log, slam_check):
    assert slam_check(slam_log).outcome == "agree"
"""
SETTINGS = """
[pytest]
addopts = --strict-markers --strict-config
filterwarnings = error
slam_logs = simulated-loop
"""


def version() -> str:
    """Return the version in pyproject.toml, the one place that has it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["version"])


def copy_source(folder: Path) -> Path:
    """Copy what is built, so that a build leaves nothing in the project. Return the folder."""
    folder.mkdir()
    for name in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for name in BESIDE:
        shutil.copy(ROOT / name, folder / name)
    return folder


def packaged() -> set[str]:
    """Return the files of the packages as git has them, data and py.typed among them."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *PACKAGES],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return {name for name in listed.stdout.splitlines() if (ROOT / name).exists()}


def wheel_faults(names: set[str], wanted: set[str]) -> list[str]:
    """Return what a wheel lacks, and what does not belong into it.

    names: its files; wanted: those of the packages.
    """
    info = f"slamcheck-{version()}.dist-info/"
    wanted = wanted | {f"{info}licenses/LICENSE", f"{info}entry_points.txt"}
    return _faults("wheel", names, wanted, info)


def sdist_faults(names: set[str], wanted: set[str]) -> list[str]:
    """Return what a source distribution lacks, and what does not belong into it."""
    inside = {name.removeprefix(f"slamcheck-{version()}/") for name in names}
    made = ("PKG-INFO", "setup.cfg", "slamcheck.egg-info/")
    return _faults("source distribution", inside, wanted | set(BESIDE), made)


def _faults(what: str, names: set[str], wanted: set[str], made: str | tuple[str, ...]) -> list[str]:
    """made: beginnings of what a build adds."""
    more = {name for name in names - wanted if not name.startswith(made)}
    faults = [f"the {what} lacks {name}" for name in sorted(wanted - names)]
    return faults + [f"the {what} has {name}" for name in sorted(more)]


def names_in(archive: Path) -> set[str]:
    """Return the names of the files in a wheel or a source distribution."""
    if archive.suffix == ".whl":
        return {one for one in zipfile.ZipFile(archive).namelist() if not one.endswith("/")}
    with tarfile.open(archive) as tar:
        return {member.name for member in tar if member.isfile()}


def done(command: Sequence[str | Path], cwd: Path) -> str:
    """Run a program to its end. Return what it prints; end the check if it fails."""
    initialised = time.monotonic()
    ended = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    words = [Path(one).name if str(one).startswith("/") else str(one) for one in command]
    shown = " ".join(" ".join(words).split())
    print(f"  {time.monotonic() - initialised:6.1f} s  {shown[:90]}", flush=True)
    if ended.returncode != 0:
        sys.exit(f"exit code {ended.returncode}: {shown}\n{ended.stdout}{ended.stderr}")
    return ended.stdout


def expect(what: str, *, holds: bool) -> None:
    """End the check where something does not hold."""
    if not holds:
        sys.exit(f"release check: {what}")


def build(python: str, work: Path) -> tuple[Path, Path]:
    """Build the source distribution, a wheel from it and one from the tree, and look into them.

    Returns: the source distribution and its wheel.
    """
    source, tools = copy_source(work / "source"), work / "tools"
    done([python, "-m", "venv", str(tools)], work)
    done([tools / "bin/pip", "install", "--quiet", "build"], work)
    done([tools / "bin/python", "-m", "build", "--outdir", "dist", "source"], work)
    done([tools / "bin/python", "-m", "build", "--wheel", "--outdir", "direct", str(source)], work)
    (sdist,), (wheel,) = work.glob("dist/*.tar.gz"), work.glob("dist/*.whl")
    (direct,) = work.glob("direct/*.whl")
    faults = sdist_faults(names_in(sdist), packaged()) + wheel_faults(names_in(wheel), packaged())
    expect("\n".join(faults), holds=not faults)
    expect(
        "the wheel from the tree is another than that from the source distribution",
        holds=names_in(wheel) == names_in(direct),
    )
    return sdist, wheel


def use(python: str, distribution: Path, home: Path) -> None:
    """Install a distribution in a fresh environment, and do with it what users do."""
    scripts, work = home / "environment/bin", home / "work"
    work.mkdir(parents=True)
    done([python, "-m", "venv", str(home / "environment")], home)
    done([scripts / "pip", "install", "--quiet", str(distribution), "pytest"], home)
    done([scripts / "pip", "check"], home)
    for command in ([scripts / "slamcheck"], [scripts / "python", "-m", "slamcheck"]):
        shown = done([*command, "--version"], work)
        expect(f"--version printed {shown!r}", holds=shown == f"slamcheck {version()}\n")
    done([scripts / "slamcheck", "run", "simulated-loop", "--out", "run"], work)
    expect("run left no report", holds=(work / "run/report.html").exists())
    done([scripts / "slamcheck", "check", "simulated-loop", "--estimate", "run/ekf"], work)
    done([scripts / "python", "-c", USE.format(version=version())], work)
    (work / "pytest.ini").write_text(SETTINGS)
    (work / "test_filter.py").write_text(TEST)
    shown = done([scripts / "python", "-m", "pytest", "-q"], work)
    expect(f"pytest printed {shown!r}", holds="1 passed" in shown)


def interpreters(named: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Return versions of Python, and the interpreter of each, "" where there is none.

    named: interpreters in place of those of each version on PATH.
    """
    for name in named or [f"python{one}" for one in PYTHONS]:
        code = "import sys; print('%d.%d' % sys.version_info[:2])"
        try:
            found = subprocess.run([name, "-c", code], capture_output=True, text=True, check=True)
            yield found.stdout.strip(), name
        except (OSError, subprocess.CalledProcessError):
            yield name.removeprefix("python"), ""


def main() -> None:
    """Check the release."""
    parser = argparse.ArgumentParser(description="Build and use what is released.")
    parser.add_argument("pythons", nargs="*", metavar="PYTHON")
    parser.add_argument("--allow-missing", action="store_true")
    asked = parser.parse_args()
    found = dict(interpreters(asked.pythons))
    missing = [one for one in {**dict.fromkeys(PYTHONS), **found} if not found.get(one)]
    for one in missing:
        print(f"skipped: Python {one}: no interpreter found (PYTHONS names them)")
    there = {one: python for one, python in found.items() if python}
    if not there or (missing and not asked.allow_missing):
        sys.exit("release check: interpreters are missing; ALLOW_MISSING=1 takes those there are")
    with tempfile.TemporaryDirectory(prefix="slamcheck-release-") as folder:
        work, initialised = Path(folder), time.monotonic()
        print("source distribution and wheels", flush=True)
        sdist, wheel = build(next(iter(there.values())), work)
        for name, python in there.items():
            print(f"wheel on Python {name}", flush=True)
            use(python, wheel, work / name)
            shutil.rmtree(work / name)
        last, python = list(there.items())[-1]
        print(f"source distribution on Python {last}", flush=True)
        use(python, sdist, work / "sdist")
        print(f"{sdist.name} and {wheel.name}: all holds, {time.monotonic() - initialised:.0f} s")


if __name__ == "__main__":
    main()
