"""Fixtures of the ngspice tests: the made-up device and the loop around it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.rom.modal import Resonators
from kc2spice.scene.schema import Catch, Contact, Control, Kick, Scene, Sphere
from kc2spice.spice.header import Header

sys.path.insert(0, str(Path(__file__).parent))
import device


@pytest.fixture(scope="session")
def radii() -> np.ndarray:
    return device.RADII


@pytest.fixture(scope="session")
def model() -> Resonators:
    return device.chip()


@pytest.fixture(scope="session")
def table() -> EMTable:
    return device.magnets()


@pytest.fixture(scope="session")
def header() -> Header:
    return Header("test", "0")


@pytest.fixture(scope="session")
def scene() -> Scene:
    """The loop at a voltage that launches the made-up device at about 1 m/s."""
    return Scene(
        name="loop",
        kick=Kick.model_validate({"drive": {"voltage": 80.0}}),
        contact=Contact(),
        sphere=Sphere(),
        catch=Catch(),
        control=Control(),
    )
