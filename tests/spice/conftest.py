"""Fixtures of the ngspice tests: the made-up device and the loop around it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.rom.model import ResonatorModel
from kc2spice.scene.schema import Scene
from kc2spice.spice.header import Header

sys.path.insert(0, str(Path(__file__).parent))
import device


@pytest.fixture(scope="session")
def radii() -> np.ndarray:
    return device.RADII


@pytest.fixture(scope="session")
def model() -> ResonatorModel:
    return device.chip()


@pytest.fixture(scope="session")
def table() -> EMTable:
    return device.magnets()


@pytest.fixture(scope="session")
def header() -> Header:
    return Header("test", "0")


@pytest.fixture(scope="session")
def scene() -> Scene:
    return device.loop()
