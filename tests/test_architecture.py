"""The house: who may import whom, no cycles, and limits that keep functions readable."""

import ast
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "ekf_reference": {"ekf_reference", "numpy", "scipy"},
    "graphslam": {"graphslam", "numpy", "scipy", "gtsam", "kiss_icp", "open3d", "libusb_package"},
}
STANDARD = {
    "__future__",
    "abc",
    "bz2",
    "collections",
    "contextlib",
    "ctypes",
    "dataclasses",
    "functools",
    "gzip",
    "importlib",
    "itertools",
    "math",
    "pathlib",
    "re",
    "tempfile",
    "types",
    "typing",
    "zlib",
}
TESTED = ("ekf_reference", "graphslam")
"""Packages whose tests run with a copy of the package and of these tests alone."""
TEST_LIBRARIES = {
    "ekf_reference": {"numpy", "scipy", "pytest"},
    "graphslam": {"numpy", "scipy", "pytest", "gtsam", "kiss_icp", "open3d"},
}
HOUSE = {"comparisons", "ekf_reference", "graphslam"}
KEYWORD_ONLY = ("ekf_reference", "graphslam", "comparisons")
"""Folders whose large dataclasses are built by field names alone."""
MOST_POSITIONAL = 5
"""Fields of a dataclass that may be given by position."""


@cache
def parsed(source: str) -> ast.Module:
    """The tree of a source, which many tests walk."""
    return ast.parse(source)


def imported(source: str) -> set[str]:
    """Top-level names of everything a module imports, anywhere in it."""
    return {name.split(".")[0] for name in states(parsed(source).body)}


def foreign(source: str, package: str) -> list[str]:
    """Return the modules, and names in them, that a test of a package imports and may not."""
    names = set(states(parsed(source).body))
    roots = {package} | TEST_LIBRARIES[package] | sys.stdlib_module_names
    return sorted(
        name
        for name in names
        if name.split(".")[0] not in roots and not f"{name}.".startswith(f"tests.{package}.")
    )


@pytest.mark.slow
def test_nothing_in_the_house_imports_the_public_interface() -> None:
    for package in sorted(HOUSE):
        for path in (ROOT / package).rglob("*.py"):
            assert "slamcheck" not in imported(path.read_text()), path


def modules(*packages: str) -> dict[str, Path]:
    """Every module of packages, or of the house, by its dotted name."""
    found = {}
    for package in packages or HOUSE:
        for path in (ROOT / package).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = path
    return found


def loads(nodes: list[ast.stmt]) -> Iterator[str]:
    """Names that are imported when a module is, those for type checkers left out."""
    for node in nodes:
        yield from named(node)
        if isinstance(node, ast.If) and not for_types(node):
            yield from loads(node.body + node.orelse)
        elif isinstance(node, ast.Try):
            yield from loads(node.body)


def reaches(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Names that are imported when a module is, or when something in it runs."""
    for node in nodes:
        yield from named(node)
        if not for_types(node):
            yield from reaches(ast.iter_child_nodes(node))


def states(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Names that are imported anywhere in a module, those for type checkers among them."""
    for node in nodes:
        for part in ast.walk(node):
            yield from named(part)


def named(node: ast.AST) -> Iterator[str]:
    """Modules, and names in them, of an import; nothing of another statement."""
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative import"
        assert node.module is not None
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)


def for_types(node: ast.AST) -> bool:
    """Whether only type checkers read what is in a statement."""
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def graph(found: Callable[[list[ast.stmt]], Iterator[str]] = loads) -> dict[str, set[str]]:
    """Which modules of the house each one loads, or reaches.

    A package's own __init__ names its modules; that is no dependency of the modules on it.
    """
    known = modules()
    return {
        name: {
            one
            for one in found(parsed(path.read_text()).body)
            if one in known and not f"{name}.".startswith(f"{one}.")
        }
        for name, path in known.items()
    }


@pytest.mark.slow
def test_no_module_imports_itself_by_way_of_others() -> None:
    assert circles(graph()) == []


@pytest.mark.slow
@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_estimators_import_nothing_of_the_house(package: str) -> None:
    own = list((ROOT / package).rglob("*.py"))
    assert len(own) > 3
    for module in own:
        extra = imported(module.read_text()) - ALLOWED[package] - STANDARD
        assert not extra, f"{module.relative_to(ROOT)} imports {sorted(extra)}"


@pytest.mark.slow
@pytest.mark.parametrize("package", TESTED)
def test_tests_of_an_estimator_import_nothing_of_the_house(package: str) -> None:
    folder = ROOT / "tests" / package
    paths = sorted(folder.rglob("*.py"))
    assert len(paths) > 3
    extra = {str(path.relative_to(ROOT)): foreign(path.read_text(), package) for path in paths}
    assert {path: names for path, names in extra.items() if names} == {}


@pytest.mark.parametrize("package", TESTED)
def test_test_folders_of_an_estimator_are_no_packages(package: str) -> None:
    """One that is would hide the estimator of the same name where tests/__init__.py is missing."""
    assert list((ROOT / "tests" / package).rglob("__init__.py")) == []


def test_tests_of_estimators_differ_in_their_base_names() -> None:
    """Where folders are no packages, pytest knows test modules by these alone."""
    folders = [ROOT / "tests" / package for package in TESTED]
    names = [path.name for folder in folders for path in folder.rglob("test_*.py")]
    assert sorted(set(names)) == sorted(names)


@pytest.mark.parametrize("package", TESTED)
def test_a_foreign_import_of_a_test_is_found(package: str) -> None:
    other = {"ekf_reference": "graphslam", "graphslam": "ekf_reference"}[package]
    own = f"import {package}.a, math, scipy.stats\nfrom tests.{package}.b.scenes import c\n"
    assert foreign(own, package) == []
    for module in ("comparisons.logs", f"tests.{other}.scenes", "tests.helpers", "hypothesis"):
        hidden = f"{own}def f():\n    from {module} import name\n"
        assert foreign(hidden, package) == [module, f"{module}.name"]


def test_the_check_itself_sees_a_hidden_import() -> None:
    hidden = "def f():\n    if True:\n        from graphslam.smoother import smooth\n"
    assert imported(hidden) == {"graphslam"}


def positional_dataclasses(sources: Iterable[str]) -> list[str]:
    """Names of the dataclasses with too many fields, those of their bases counted, by position."""
    trees = [ast.walk(parsed(source)) for source in sources]
    classes = [node for tree in trees for node in tree if isinstance(node, ast.ClassDef)]
    named = {one.name: one for one in classes if "dataclass" in decorators(one)}

    def fields(one: ast.ClassDef) -> int:
        own = [node for node in one.body if isinstance(node, ast.AnnAssign)]
        marks = [k for k, node in enumerate(own) if ast.unparse(node.annotation) == "KW_ONLY"]
        own = own[: marks[0]] if marks else own
        inherited = [ast.unparse(base).split(".")[-1] for base in one.bases]
        return sum("ClassVar" not in ast.unparse(node.annotation) for node in own) + sum(
            fields(named[base]) for base in inherited if base in named
        )

    return sorted(
        one.name
        for one in classes
        if "dataclass" in decorators(one)
        and "kw_only=True" not in decorators(one)
        and fields(one) > MOST_POSITIONAL
    )


def decorators(one: ast.ClassDef) -> str:
    """What stands above a class."""
    return " ".join(ast.unparse(decorator) for decorator in one.decorator_list)


@pytest.mark.slow
@pytest.mark.parametrize("folder", KEYWORD_ONLY)
def test_large_dataclasses_take_keywords_only(folder: str) -> None:
    paths = sorted((ROOT / folder).rglob("*.py"))
    assert len(paths) > 3
    assert positional_dataclasses(path.read_text() for path in paths) == []


SMALL = "@dataclass\nclass Small:\n" + "".join(f"    f{i}: int\n" for i in range(5))
HEIR = "@dataclass(frozen=True)\nclass Heir(Small):\n    last: int = 0\n"


def test_a_large_positional_dataclass_is_found() -> None:
    assert positional_dataclasses([SMALL, HEIR]) == ["Heir"]
    assert positional_dataclasses([SMALL + "    last: int = 0\n"]) == ["Small"]
    assert positional_dataclasses([SMALL, HEIR.replace("True", "True, kw_only=True")]) == []
    assert positional_dataclasses([SMALL + "    last: ClassVar[int] = 0\n"]) == []


def on_research(sources: Iterable[tuple[str, str]]) -> list[str]:
    """Return the modules that import research anywhere, or name a module of it to be loaded.

    sources: name and text of each module.
    """
    return [
        name
        for name, source in sources
        if any(module.partition(".")[0] == "research" for module in mentions(source))
    ]


@pytest.mark.slow
def test_the_product_imports_nothing_of_research() -> None:
    product = modules(*HOUSE, "slamcheck")
    assert "slamcheck.__main__" in product
    assert on_research((name, path.read_text()) for name, path in product.items()) == []


@pytest.mark.parametrize(
    "line",
    [
        "from research.script import options",
        "import research.documents.runner as runner",
        "if TYPE_CHECKING:\n        from research import bench",
        "shown = resolve_name('research.documents.registry:FIGURES')",
    ],
)
def test_a_product_that_stands_on_research_is_rejected(line: str) -> None:
    broken = f"def shown():\n    {line}\n"
    assert on_research([("slamcheck.shown", broken)]) == ["slamcheck.shown"]
    assert on_research([("slamcheck.shown", broken.replace("research", "researcher"))]) == []


def test_nothing_stands_on_experiments() -> None:
    """But the command that runs them."""
    for path in (ROOT / "comparisons").rglob("*.py"):
        name = path.relative_to(ROOT / "comparisons").as_posix()
        if not name.startswith("experiments/") and name != "cli/montecarlo.py":
            assert "comparisons.experiments" not in path.read_text(), f"{name} names experiments"


APART = (
    "comparisons.logs.readers.",  # found by the name of a format
)
"""Modules, or beginnings of them, that are in the wheel though nothing in it imports them."""


def reached(edges: dict[str, set[str]], starts: Iterable[str]) -> set[str]:
    """Return what can be got to."""
    found, todo = set[str](), list(starts)
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += edges[name]
    return found


def mentions(source: str) -> Iterator[str]:
    """Modules that a module imports anywhere, names as a string, or is a part of."""
    for node in ast.walk(parsed(source)):
        yield from named(node)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value.partition(":")[0]


@pytest.mark.slow
def test_the_wheel_holds_nothing_that_only_tests_and_research_use() -> None:
    known = modules(*HOUSE, "slamcheck")
    edges = {name: set(mentions(path.read_text())) & set(known) for name, path in known.items()}
    starts = [name for name in known if name.startswith(("slamcheck", "comparisons.cli"))]
    folders = {name for name in known if known[name].name == "__init__.py"}
    assert "comparisons.jobs.run" in reached(edges, starts)
    unused = set(known) - folders - reached(edges, starts)
    assert [name for name in sorted(unused) if not name.startswith(APART)] == []


def test_a_module_that_nothing_reaches_is_found() -> None:
    edges: dict[str, set[str]] = {"cli": {"jobs"}, "jobs": {"cli"}, "strangers": {"jobs"}}
    assert set(edges) - reached(edges, ["cli"]) == {"strangers"}
    assert list(mentions("def f():\n    from a import b\nC = 'd:e'\n")) == ["a", "a.b", "d"]


LAYERS = {
    "arrays": 0, "errors": 0, "atomic": 0, "archive": 0, "words": 0, "plane": 0, "statistics": 0,
    "covariances": 0, "rounding": 0,
    "figures": 0, "shown": 0, "trace": 0, "innovations": 0, "extension_names": 0,
    "logs": 1, "options": 1,
    "config": 2, "documented": 2, "estimates": 2,
    "settings": 3, "adapters": 3, "audit": 3, "faults": 3, "explain": 3,
    "checks": 4,
    "pipeline": 5,
    "fingerprints": 6,
    "jobs": 7,
    "report": 8,
    "extensions": 9,
    "baseline": 10,
    "cli": 11, "experiments": 11,
}  # fmt: skip
"""Parts of comparisons from the ground up: each stands on its own level and those below.

No module is an exception."""


def level(module: str) -> int:
    """Of the part that a module is in; -1 outside comparisons."""
    house, _, name = module.partition(".")
    return LAYERS.get(name.partition(".")[0], -1) if house == "comparisons" else -1


def upward(edges: dict[str, set[str]]) -> list[str]:
    """Return imports that lead from a part of comparisons to one above it."""
    return sorted(
        f"{name} imports {one}"
        for name, to in edges.items()
        for one in to
        if level(one) > level(name)
    )


@pytest.mark.slow
def test_data_flows_one_way() -> None:
    edges = {name: to for name, to in graph(reaches).items() if name.startswith("comparisons.")}
    assert all(level(name) >= 0 for name in edges), "a part of comparisons without a level"
    assert upward(edges) == []


def circles(edges: dict[str, set[str]]) -> list[set[str]]:
    """Return the sets of several modules each of which reaches all others of its set."""
    led = {name: reached(edges, to) for name, to in edges.items()}
    sets = [frozenset(o for o in led[n] if n in led[o]) for n in edges if n in led[n]]
    return [set(one) for one in dict.fromkeys(sets)]


@pytest.mark.slow
def test_a_circle_stays_in_one_room() -> None:
    """By imports inside functions and for type checkers, too, and has two modules at most."""
    found = circles(with_folders(graph(states)))
    assert max(map(len, found)) <= 2
    for circle in found:
        assert len({name.rpartition(".")[0] for name in circle}) == 1, sorted(circle)


def with_folders(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return a graph where who loads a module loads the folders in which it is, too.

    A folder that names its own modules is no dependency of them on it.
    """
    return {
        name: {
            one
            for module in to
            for one in (module, *folders(module))
            if one in edges and one != name and not name.startswith(f"{one}.")
        }
        for name, to in edges.items()
    }


def folders(module: str) -> Iterator[str]:
    """Every package that is loaded before a module of it."""
    while module := module.rpartition(".")[0]:
        yield module


def test_a_circle_is_found() -> None:
    edges = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a", "d"}}
    assert circles(edges) == [{"b", "c"}, {"d"}]
    # A folder's own file reaches back to who loads a module of it.
    edges = {"a": {"b"}, "b": {"c.one"}, "c": {"a"}, "c.one": set()}
    assert circles(edges) == []
    assert circles(with_folders(edges)) == [{"a", "b", "c"}]


def test_an_import_inside_a_function_is_one() -> None:
    hidden = (
        "def f():\n    if x:\n        with y:\n            from comparisons.report import rows\n"
    )
    assert list(reaches(parsed(hidden).body)) == ["comparisons.report", "comparisons.report.rows"]
    assert list(loads(parsed(hidden).body)) == []


def test_an_import_for_type_checkers_is_one() -> None:
    typed = "if TYPE_CHECKING:\n    from comparisons.report import rows\n"
    assert list(reaches(parsed(typed).body)) == []
    assert "comparisons.report.rows" in states(parsed(typed).body)


def test_the_picture_of_a_covariance_names_files_that_exist() -> None:
    walk = (ROOT / "docs" / "walk.svg").read_text(encoding="utf-8")
    named = re.findall(r">\d+  ([^<]+)<", walk)
    assert len(named) > 10
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_an_import_upward_is_found() -> None:
    edges = {"comparisons.checks.verdict": {"comparisons.report.rows", "comparisons.logs.log"}}
    assert upward(edges) == ["comparisons.checks.verdict imports comparisons.report.rows"]


ROOMS = {
    "core": {"core", "models"},
    "models": {"core"},
    "filters": {"core", "models"},
    "association": {"association", "core"},
    "fastslam": {"core", "fastslam", "models"},
    "features": {"core"},
    "dense": {"association", "core", "dense"},
    "scan_matching": {"core", "dense", "scan_matching"},
    "scan_landmarks": {"core", "dense", "models", "scan_landmarks", "scan_matching"},
}
"""Folders of ekf_reference, and those that each may import: the filter knows no feature."""


def trespasses(sources: Iterable[tuple[str, str]]) -> list[str]:
    """Return the imports of ekf_reference's folders from others than they may know.

    sources: folder and text of each module.
    """
    return sorted(
        {
            f"{room} imports {name.split('.')[1]}"
            for room, source in sources
            for name in loads(parsed(source).body)
            if name.startswith("ekf_reference.") and name.split(".")[1] not in ROOMS[room]
        }
    )


def test_rooms_of_the_reference_know_only_those_below() -> None:
    paths = [path for room in ROOMS for path in (ROOT / "ekf_reference" / room).rglob("*.py")]
    assert len(paths) == len(list((ROOT / "ekf_reference").rglob("*.py"))) - 1
    rooms = [path.relative_to(ROOT / "ekf_reference").parts[0] for path in paths]
    assert trespasses(zip(rooms, (path.read_text() for path in paths), strict=True)) == []


def test_a_filter_that_knows_a_feature_is_found() -> None:
    source = "from ekf_reference.scan_landmarks.merging import DuplicateMerging"
    assert trespasses([("filters", source)]) == ["filters imports scan_landmarks"]


@pytest.mark.slow
def test_no_extension_imports_another_but_what_it_stands_on() -> None:
    """A feature knows nobody's internals: only sources that another one offers."""
    stands_on = {
        "own_matching": {"scan_landmarks.source"},
        "scan_landmarks": {"dense_maps.source", "dense_maps.config"},
        "dynamic": {"dense_maps.source"},
        "high_level": {"dense_maps.source", "dense_maps.config"},
    }
    prefix = "comparisons.extensions."
    for name, to in graph().items():
        if name.startswith(prefix) and name.count(".") > 2:
            own = name.removeprefix(prefix).split(".")[0]
            others = {one.removeprefix(prefix) for one in to if one.startswith(prefix)}
            others = {one for one in others if "." in one and one.split(".")[0] != own}
            assert others <= stands_on.get(own, set()), f"{name} imports {sorted(others)}"


TWINS = {
    "LandmarkKind": "each estimator has a table of what it may measure",
    "Layout": "each estimator has an order of its states' entries",
    "LoopClosures": "of a log with its units, and of a graph with its keys",
    "Stabilisation": "each estimator adds the same small noise",
    "Template": "each estimator has a landmark's shape",
}
"""Public classes that share a name on purpose, and why: estimators know nothing of each other."""


def places_of_classes(sources: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Folders of each public class at the top of a module, a folder as often as it has one."""
    places: dict[str, list[str]] = {}
    for path, source in sources:
        for state in parsed(source).body:
            if isinstance(state, ast.ClassDef) and not state.name.startswith("_"):
                places.setdefault(state.name, []).append(path.partition("/")[0])
    return {name: sorted(folders) for name, folders in places.items() if len(folders) > 1}


def test_no_two_classes_share_a_name() -> None:
    """Of the product and of research; examples stand alone, each by itself."""
    folders = ("comparisons", "ekf_reference", "graphslam", "slamcheck", "research")
    sources = [
        (path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
    ]
    shared = places_of_classes(sources)
    assert set(shared) == set(TWINS)
    for name, places in shared.items():
        assert len(places) == len(set(places)) == 2, name
        assert set(places) & set(TESTED), name


def test_a_second_class_of_a_name_is_found() -> None:
    twice = [("comparisons/a.py", "class Row: ..."), ("comparisons/b.py", "class Row: ...")]
    assert places_of_classes(twice) == {"Row": ["comparisons", "comparisons"]}
    assert places_of_classes(twice[:1]) == {}


CORE, MOST_LINES = ("core", "models", "filters", "association"), 2_000
"""Folders of ekf_reference that are read as one, and their lines of code together."""


def lines_of_code(source: str) -> int:
    """Count the lines that are neither blank nor comments, docstrings or imports."""
    left_out = set[int]()
    for node in ast.walk(parsed(source)):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_text or isinstance(node, ast.Import | ast.ImportFrom):
            assert isinstance(node, ast.stmt)
            left_out |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    rows = enumerate(source.splitlines(), 1)
    return sum(bool(line.partition("#")[0].strip()) and row not in left_out for row, line in rows)


def test_the_core_of_the_reference_stays_small() -> None:
    paths = [path for room in CORE for path in (ROOT / "ekf_reference" / room).rglob("*.py")]
    assert 1_000 < sum(lines_of_code(path.read_text()) for path in paths) <= MOST_LINES


def test_lines_of_code_are_counted() -> None:
    source = '"""Text\n\nof a module."""\n\nimport re\nfrom a import (\n    b,\n)\n\n# why\n'
    source += 'X = 1  # one\n"""Of X."""\n\n\n'
    source += 'def f():\n    """Do."""\n    return (\n        X\n    )\n'
    assert lines_of_code(source) == 5
