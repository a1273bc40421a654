"""The made-up device of the ngspice tests, and the loop around it."""

import device
import pytest
from support import load_scene


@pytest.fixture(scope="session")
def loop(model):
    """The whole loop around the made-up chip and field."""
    return device.built(load_scene("kick_and_catch"), model, device.magnets())
