"""The made-up device of the ngspice tests, and the loop around it."""

import device
import pytest

from kc2spice.rom.modal import Resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build


@pytest.fixture(scope="session")
def loop(model: Resonators) -> Build:
    """The whole loop around the made-up chip and field."""
    return device.built(load_scene("kick_and_catch"), model, device.magnets())
