"""Lower bound and peers against the event-driven reference, forms in .ac."""

import numpy as np
import pytest
from support import make_deck, run_deck

from bench.distance import compare
from bench.law import law
from bench.located import located
from bench.lower_bound import LowerBound


@pytest.fixture(scope="module")
def exact(loop):
    return located(law(loop), loop.scene)


def opens(waves):
    """The located instant [s] at which the last ring opens before the sphere flies."""
    force, t = waves["contact.force"], waves["time"]
    last = np.flatnonzero((force > 0) & (t < 0.6e-3))[-1]
    return t[last + 1]


def test_lower_bound_flies_the_loop_exactly(loop, exact):
    waves = LowerBound(law(loop)).run(loop.scene)
    error = compare(waves, exact)
    # The magnets' pull is linearised for 2 us at a time during contact; all else is exact.
    assert error["launch"] < 1e-5
    assert abs(opens(waves) - opens(exact)) < 1e-11
    assert error["position_m"] < 2e-8


def test_ngspice_flies_the_same_loop(loop, exact, tmp_path):
    """The netlist comes from the parts, the exact solution from the benchmark's own equations."""
    error = compare(run_deck(make_deck(loop), tmp_path), exact)
    assert error["launch"] < 1e-4
    assert error["position_m"] < 1e-6
