"""The made-up device of the ngspice tests, and the loop around it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.rom.model import ResonatorModel
from kc2spice.scene.schema import Scene

sys.path.insert(0, str(Path(__file__).parents[1] / "spice"))
import device


@pytest.fixture(scope="session")
def model() -> ResonatorModel:
    return device.chip()


@pytest.fixture(scope="session")
def table() -> EMTable:
    return device.magnets()


@pytest.fixture(scope="session")
def scene() -> Scene:
    return device.loop()
