"""What the program says of itself: help and the list of settings."""

import re
import tomllib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from comparisons.cli.app import COMMANDS, build
from comparisons.cli.config import JobName, _kind
from comparisons.cli.flags import Arguments, DenseHelpCommand, from_flags
from comparisons.config import JOBS, config_class
from comparisons.extension_names import EXTENSIONS
from comparisons.options.table import FLAGS, of_job
from tests.commands import refused

RUN = of_job("run")
MOST_LINES = 46
"""Of the help of a command, with 80 columns."""
GROUPS = ("baseline save", "baseline compare")
HELPS = ("", *COMMANDS, *GROUPS)


def commands() -> Iterator[tuple[str, Any]]:
    """Every command by its name."""
    whole: Any = build(whole=True)
    for name, command in whole.commands.items():
        below = getattr(command, "commands", {})
        if not below:
            yield name, command
        for part in below.values():
            yield f"{name} {part.name}", part


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    name = arguments[0] if arguments and arguments[0] in COMMANDS else None
    words = arguments[1:] if name else arguments
    prog = f"slamcheck {name}" if name else "slamcheck"
    build(name)(args=list(words), prog_name=prog, standalone_mode=False)
    return capsys.readouterr().out


@pytest.fixture(autouse=True)
def _terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.parametrize("name", HELPS)
def test_help_is_short(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, *name.split(), "--help").splitlines()
    assert 5 < len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= 80


def test_a_help_with_all_options_is_too_long(capsys: pytest.CaptureFixture[str]) -> None:
    import typer

    @from_flags(RUN, " ".join(flag.option for flag in RUN))
    def run(given: Arguments) -> None:
        """Run."""

    app = typer.Typer()
    app.command(cls=DenseHelpCommand)(run)
    typer.main.get_command(app)(args=["--help"], standalone_mode=False)
    assert len(capsys.readouterr().out.splitlines()) > MOST_LINES


def undocumented(command: Any, text: str) -> set[str]:
    """Options of a command that a text does not name."""
    options = {one for param in command.params for one in param.opts if one.startswith("--")}
    return options - set(re.findall(r"--[a-z][a-z-]*", text))


@pytest.mark.parametrize("job", [*JobName], ids=str)
def test_what_help_hides_the_list_of_settings_has(
    job: JobName, capsys: pytest.CaptureFixture[str]
) -> None:
    command: Any = build(job.value)
    helped = printed(capsys, job.value, "--help")
    listed = printed(capsys, "config", job.value)
    assert not undocumented(command, helped + listed)
    hidden = sorted(undocumented(command, helped))
    cut = re.sub(rf"{hidden[0]}\b", "", helped + listed)
    assert hidden[0] in undocumented(command, cut)


def test_what_only_saving_a_baseline_hides_is_listed_too(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = dict(commands())["baseline save"]
    texts = [printed(capsys, "baseline", "save", "--help")]
    texts += [printed(capsys, "config", job) for job in ("run", "check")]
    assert not undocumented(command, "".join(texts))
    assert undocumented(command, texts[0] + texts[1]) >= {"--times", "--min-coverage"}


def test_the_list_has_each_setting_with_its_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    for job in JobName:
        listed = printed(capsys, "config", job.value)
        lines = listed.splitlines()
        assert max(map(len, lines)) <= 80
        for above, line in pairwise(lines):
            if re.match(r"#?[a-z_]+ = ", line):
                assert above.startswith("# "), line
        if job.value in JOBS:
            kind = JOBS[job.value]
            assert kind.of(**tomllib.loads(listed)) == kind.of()


def in_examples(name: str, text: str) -> set[str]:
    """Options that a help's examples give to a command."""
    examples = re.findall(rf"slamcheck {name} .*", text.partition("\n\n Example")[2].split("╭")[0])
    return set(re.findall(r" (--?[a-z][a-z-]*)", "\n".join(examples)))


def test_help_lists_every_option_that_its_examples_use(capsys: pytest.CaptureFixture[str]) -> None:
    for name, _ in commands():
        text = printed(capsys, *name.split(), "-h")
        _, title, panels = text.partition("╭")
        assert title, name
        assert in_examples(name, text) <= set(re.findall(r"--?[a-z][a-z-]*", panels)), name
    hidden = "\n\n Examples:\n  slamcheck run my-log --seed 1 --live\n╭ --seed N"
    assert in_examples("run", hidden) == {"--seed", "--live"}


def unclear(text: str) -> bool:
    """Whether a text is no sentence and no noun phrase that stands by itself."""
    fragment = re.match(r"(Of|The same|Which|Then|Whether|With it|Their|Its)\b", text)
    return not (text[:1].isupper() or text[:1].isdigit()) or text[-1] not in ".]" or bool(fragment)


def test_every_line_of_help_stands_by_itself() -> None:
    for name, command in commands():
        assert not unclear(command.help.split("\n\n")[0]), name
        for one in command.params:
            text = (one.help or "").strip()
            assert not text or not unclear(text), f"{name} {one.opts}: {text}"
    for job in JobName:
        kinds: list[type[BaseModel]] = [_kind(job), *(config_class(name) for name in EXTENSIONS)]
        while kinds:
            kind = kinds.pop()
            for name, field in kind.model_fields.items():
                if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
                    kinds.append(field.annotation)
                elif name not in ("job", "extensions"):
                    text = (field.description or "").removeprefix("compressed-suboptimal: ")
                    assert text, name
                    assert not unclear(f"{text[0].upper()}{text[1:]}."), name
                    assert text[0].isupper() or text != field.description, f"{name}: {text}"
    assert unclear("Of a speed.")
    assert unclear("Which EKF. [full]")
    assert unclear("leave out what is before")


def test_help_names_every_choice_and_the_default() -> None:
    usual = [kind.of().model_dump() for kind in JOBS.values()]
    for flag in FLAGS:
        if not flag.help:
            continue
        for word in flag.words:
            assert re.search(rf"\b{re.escape(word)}\b", flag.help), f"{flag.option} {word}"
        found = re.search(r"\[(\S+)\]$", flag.help)
        for config in usual if found else ():
            value: Any = config
            for part in flag.field.split("."):
                value = value.get(part) if isinstance(value, dict) else None
            if isinstance(value, bool):
                value = "on" if value else "off"
            if found and value not in (None, ()):
                assert str(value).removesuffix(".0") == found[1], flag.option


def test_an_earlier_spelling_is_any_unknown_word(tmp_path: Path) -> None:
    """An option's choices are named; so are a setting's, in a file."""
    said = refused("run", "simulated-loop", "--preset", "as-published", cwd=tmp_path)
    assert "'as-published' is not one of 'recommended', 'guivant-2002', 'misono-2007'" in said
    for text, expected in (
        ('preset = "as-published"', "preset is 'as-published': input should be 'recommended', "),
        ('[log]\nsigmas = "calibrated"', "log.sigmas is 'calibrated': input should be 'log' or "),
        ("[extensions.dense_maps]\nattribute_values = false", "attribute_values: is unknown, "),
    ):
        (tmp_path / "run.toml").write_text(f"{text}\n")
        said = refused("run", "simulated-loop", "--config", "run.toml", cwd=tmp_path)
        assert said.startswith("slamcheck: run.toml: ")
        assert expected in said
