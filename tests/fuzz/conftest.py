"""One sandbox for all tests of a process; at the end the number of cases is told."""

from collections.abc import Iterator

import pytest

from tests.fuzz.sandbox import Sandbox

_SANDBOX = pytest.StashKey[Sandbox]()


@pytest.fixture(scope="session")
def sandbox(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    made = Sandbox(tmp_path_factory.mktemp("fuzz"))
    request.config.stash[_SANDBOX] = made
    yield made
    made.close()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    made = config.stash.get(_SANDBOX, None)
    if made is not None:
        terminalreporter.section(f"{made.cases.total():,} cases of damaged input")
        for name, count in made.cases.most_common():
            terminalreporter.write_line(f"{count:8,} {name}")
