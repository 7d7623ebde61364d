"""Count the cases that were tried, by kind, with their time, and report them at the end."""

import os
from collections import Counter
from collections.abc import Generator

import pytest

from tests.fuzz.damage import COUNT


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Hand on what a test has counted, also from another process."""
    COUNT.clear()
    begin = sum(os.times()[:4])
    try:
        return (yield)
    finally:
        used = sum(os.times()[:4]) - begin
        total = sum(COUNT.values())
        for kind, n in COUNT.items():
            item.user_properties.append((f"cases of {kind}", (n, used * n / total)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line for each kind, and one for all."""
    number, used = Counter[str](), Counter[str]()
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, value in getattr(report, "user_properties", ()):
                if name.startswith("cases of ") and getattr(report, "when", "") == "call":
                    number[name.removeprefix("cases of ")] += value[0]
                    used[name.removeprefix("cases of ")] += value[1]
    if number:
        terminalreporter.section("cases tried")
        for kind, n in sorted(number.items()):
            terminalreporter.write_line(f"{n:7,}  {used[kind]:7.1f} s of processor time  {kind}")
        terminalreporter.write_line(
            f"{sum(number.values()):7,}  {sum(used.values()):7.1f} s of processor time  in all"
        )
