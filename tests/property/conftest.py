"""Prints what the property tests measured when pytest is run with -v."""

import pytest
from figures import summary


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Counts, quantiles and extremes of every figure."""
    lines = summary() if config.getoption("verbose") >= 1 else []
    if lines:
        terminalreporter.section("measured over random scenes")
        terminalreporter.write_line("\n".join(lines))
