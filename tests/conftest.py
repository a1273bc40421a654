"""What several files of tests begin with."""

import device
import pytest
from typer.testing import CliRunner

from kc2spice.cli.main import app


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
