"""Frequencies at which a full model is solved are chosen by the reduced one's response."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from kc2spice.rom.linear import LinearModel, Port
from kc2spice.workflow.verify.bodies import _first


@pytest.mark.parametrize("weak", [1.0, 1e-6])
def test_ports_that_do_not_answer_each_other_choose_as_well(weak: float) -> None:
    """Two resonators of 1 and 2 Hz at a port each, however strong: both peaks are taken, without a
    warning."""
    unit = np.diag([1.0, weak])
    omega = 2 * np.pi * np.array([1.0, 2.0])
    ports = tuple(Port(name, "mechanical") for name in "ab")
    model = LinearModel(M=np.eye(2), E=np.diag(0.01 * omega), K=np.diag(omega**2), B=unit, C=unit,
                        D=0 * unit, ports=ports)  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = _first(model, np.linspace(0.1, 3.0, 30), 4)
    assert {1.0, 2.0} <= set(np.round(chosen, 9))
