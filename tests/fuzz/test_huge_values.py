"""Values of thousands of characters through every way in: one short line.

Each way of a configuration, an option, a word of a file and an argument in Python is tried with
each kind of value.
"""

import re
import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

import slamcheck
from comparisons import errors
from comparisons.config import JOBS, JobConfig, SettingsGroup, config_class
from comparisons.errors import InputError, note, one_line, quoted, shorten
from comparisons.extension_names import EXTENSIONS
from comparisons.logs.log_folder import write_log_folder
from comparisons.options.table import of_job
from comparisons.settings import configure
from comparisons.trace.recorder import Recorder
from tests.fuzz.subjects import SUBJECTS
from tests.fuzz.test_hostile_files import outcome, run_main
from tests.helpers import simulated

HUGE = {
    "decimals": "9" * 5000,
    "hexadecimals": "0x" + "1" * 4200,
    "negative": "-0x" + "8" * 4200,
    "fraction": "7" * 2000 + ".5",
    "word": "x" * 5000,
    "quoted": '"' + "y" * 5000 + '"',
    "words": '"' + "a b " * 1300 + '"',
    "list": "[" + "1, " * 3000 + "1]",
}
LONGEST = 1000
"""Characters of a line."""
_LOGS = {"topic": "--topic", "robot": "--robot", "format": "--format"}


def assert_short(code: int, reported: str) -> None:
    assert code in (0, 1, 2, 3), reported[-2000:]
    assert max(map(len, reported.splitlines()), default=0) <= LONGEST, reported[:2000]


def settings_of(kind: type[BaseModel], section: str = "") -> Iterator[str]:
    """Dotted names of all settings and sections."""
    for name, field in kind.model_fields.items():
        yield f"{section}{name}"
        hint = field.annotation
        for part in typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from settings_of(part, f"{section}{name}.")


def every_setting(job: type[SettingsGroup]) -> list[str]:
    names = list(settings_of(job))
    for extension in EXTENSIONS if "extensions" in job.model_fields else ():
        names += settings_of(config_class(extension), f"extensions.{extension}.")
    return [*names, "strange", "log.strange"]


def settled(make: Callable[[], JobConfig], again: Path) -> None:
    """A configuration that is refused in a short line, or can be written and read again."""
    refused = ""
    try:
        config = make()
    except InputError as error:
        refused = str(error)
    assert len(refused) <= LONGEST, refused[:2000]
    if refused:
        return
    again.write_text(config.toml(), encoding="utf-8")
    assert configure(type(config), again) == config


@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize("value", HUGE)
def test_a_setting(job: str, value: str, tmp_path: Path) -> None:
    """By --set and in a file; the key as well."""
    kind, text = JOBS[job], HUGE[value]
    file, again = tmp_path / "given.toml", tmp_path / "again.toml"
    for name in every_setting(kind):
        settled(lambda name=name: configure(kind, settings=[f"{name}={text}"]), again)  # type: ignore[misc]
        file.write_text(f"{name} = {text}\n")
        settled(lambda: configure(kind, file), again)
        file.write_text(f"{name}.{text} = 1\n")
        settled(lambda: configure(kind, file), again)
        settled(lambda name=name: configure(kind, settings=[f"{name}.{text}=1"]), again)  # type: ignore[misc]
    settled(lambda: configure(kind, settings=[text]), again)


@pytest.mark.parametrize("job", JOBS)
def test_an_option(job: str) -> None:
    """Beside a log that is not there: all that an option says by itself is said before."""
    for flag in of_job(job):
        for text in HUGE.values():
            words = [job, "/nowhere", f"{flag.option}={text}"]
            assert_short(*outcome(lambda words=words: run_main(words)))  # type: ignore[misc]


@pytest.mark.parametrize("option", _LOGS.values(), ids=_LOGS)
def test_an_option_of_the_log(option: str, tmp_path: Path) -> None:
    """These are said by readers. `0x1...1` for a robot had exit code 70."""
    write_log_folder(simulated(2, loop_s=5.0), tmp_path / "log")
    for place in (str(tmp_path / "log"), "simulated-loop"):
        for text in HUGE.values():
            setting = f"log.{option[2:]}{'s' * (option == '--topic')}"
            for words in ([f"{option}={text}"], ["--set", f"{setting}={text}"]):
                called = ["solve", place, *words]
                code, reported = outcome(lambda called=called: run_main(called))  # type: ignore[misc]
                assert code == 2
                assert_short(code, reported)


def test_an_argument_of_another_command(tmp_path: Path) -> None:
    for text in HUGE.values():
        for words in (
            ["new-log", text, "--odometry", text, "--measurements", text],
            ["new-log", "log", "--odometry", "x", "--measurements", "x", "--unit", text],
            ["new-log", "log", "--odometry", "x", "--measurements", "x", "--unit", f"a={text}"],
            ["new-log", "log", "--odometry", "x", "--measurements", "x", "--prior-pose", text],
            ["check", text, "--estimate", text],
            ["audit", text],
            ["baseline", "compare", text, text],
            ["compare", text, text],
            ["explain", text],
            ["export", text, text],
            ["convert", text, text],
            ["montecarlo", text, "--runs", text],
            ["montecarlo", "--command", text],
            ["config", text],
            [text],
        ):
            code, reported = outcome(lambda words=words: run_main(words))  # type: ignore[misc]
            assert code in (0, 2), (words[0], reported[-2000:])
            if reported.startswith("slamcheck: "):  # else the usage, in a frame
                assert len(reported) <= 2 * LONGEST * (1 + words.count(text)), reported[:2000]
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", SUBJECTS)
def test_a_word_of_a_file(name: str) -> None:
    """Of a header, the first record and the last; of each line of TOML and JSON."""
    subject = SUBJECTS[name]
    for file, content in subject.files.items():
        try:
            lines = content.decode().splitlines(keepends=True)
        except UnicodeDecodeError:
            continue
        few = 60 if file.endswith(("toml", "json")) else 2
        for k in sorted({*range(min(len(lines), few)), len(lines) - 1}):
            words = re.split(r"([\s,=:\[\]]+)", lines[k])
            for place in range(0, min(len(words), 40), 2):
                for text in HUGE.values() if words[place] else ():
                    damaged = "".join([*words[:place], text, *words[place + 1 :]])
                    with subject.written() as folder:
                        (folder / file).write_text("".join([*lines[:k], damaged, *lines[k + 1 :]]))
                        assert_short(*outcome(lambda folder=folder: subject.read(folder)))  # type: ignore[misc]


def test_an_argument_in_python(tmp_path: Path) -> None:
    number, text = 10**5000, "x y" * 2000
    recorder = Recorder(tmp_path / "mine.trace")
    recorder.prior({"pose": 3}, [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    log = simulated(2, loop_s=5.0)
    calls: tuple[Callable[[], object], ...] = (
        lambda: slamcheck.run_config(robot=number),
        lambda: slamcheck.run_config(gate=number),
        lambda: slamcheck.run_config(filter=number),
        lambda: slamcheck.run_config(**{text: 1}),
        lambda: slamcheck.load_log("simulated-loop", loops=number),
        lambda: slamcheck.load_log("simulated-loop", robot=number),
        lambda: slamcheck.load_log("simulated-loop", seed=-number),
        lambda: slamcheck.load_log(text),
        lambda: slamcheck.check(log, text, require=text),  # type: ignore[arg-type]
        lambda: recorder.predict([[1.0]], [[1.0]], [text]),
        lambda: recorder.augment(text * 9, [[1.0]], [[1.0]], [[1.0]], [text]),
    )
    for call in calls:
        with pytest.raises((InputError, TypeError)) as raised:
            call()
        assert len(str(raised.value)) <= LONGEST


def test_what_a_message_quotes() -> None:
    assert shorten("sensor\nx") == "sensor?x"
    assert quoted("sensor\nx") == r"'sensor\nx'"
    assert shorten("x" * 40) == "x" * 40
    assert shorten("x" * 41) == "x" * 37 + "..."
    assert shorten(12) == quoted(12) == "12"
    assert shorten(10**5000) == quoted([10**5000]) == "a number of thousands of digits"
    assert len(quoted("x" * 10**6)) == len(quoted(b"x" * 10**6)) == 40
    assert quoted([1] * 10**4).endswith("...")
    path = "/" + "/".join(["a" * 255] * 8) + "/log.toml"
    assert one_line(f"{path}: no such file") == f"{path}: no such file"
    assert len(one_line("a b " * 10**4)) < 3010
    assert str(InputError("y" * 10**6)) == "y" * 37 + "..."


def test_a_message_that_is_not_cut_is_noticed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    note("x" * 10**5)
    assert_short(0, capsys.readouterr().err)
    monkeypatch.setattr(errors, "_LONGEST", 10**9)
    note("x y " * 10**5)
    with pytest.raises(AssertionError):
        assert_short(0, capsys.readouterr().err)
    monkeypatch.setattr("comparisons.settings.shorten", str)
    with pytest.raises(AssertionError):
        settled(lambda: configure(JOBS["run"], settings=["a b" * 5000]), Path("unused"))
