"""Prints what the accuracy tests measured when pytest is run with -v."""

import pytest


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """A line per measured figure: what a note about accuracy quotes."""
    if config.getoption("verbose") < 1:
        return
    lines = [
        f"{report.nodeid.split('::')[-1]:<70} {name:<24} {value:.6g}"
        for outcome in ("passed", "failed", "xfailed")
        for report in terminalreporter.getreports(outcome)
        for name, value in report.user_properties
        if isinstance(value, float)
    ]
    if lines:
        terminalreporter.section("measured")
        terminalreporter.write_line("\n".join(lines))
