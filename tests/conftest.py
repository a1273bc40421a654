"""Fixtures that several test files share."""

import signal

import device
import pytest
from support import app
from typer.testing import CliRunner


def pytest_collection_modifyitems(items):
    """A campaign is slow."""
    for item in items:
        if item.get_closest_marker("campaign"):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session", autouse=True)
def interruptible():
    """Children end by Ctrl-C, also where a shell started the tests with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def cli(tmp_path, monkeypatch):
    """Runs a command in an empty directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KC2SPICE_DEBUG", raising=False)
    return lambda *words: CliRunner().invoke(app, list(words))


@pytest.fixture(scope="session")
def model():
    """The made-up chip."""
    return device.chip()


@pytest.fixture
def scene_file(tmp_path):
    """Writes a scene and returns its path."""

    def write(text):
        path = tmp_path / "my.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write
