"""The made-up device of the ngspice tests, and the loop around it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from kc2spice.rom.modal import Resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "spice")]
import device  # noqa: E402


@pytest.fixture(scope="session")
def model() -> Resonators:
    return device.chip()


@pytest.fixture(scope="session")
def loop(model: Resonators) -> Build:
    """The whole loop around the made-up chip and field."""
    return device.built(load_scene("kick_and_catch"), model, device.magnets())
