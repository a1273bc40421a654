"""By what a difference of two metrics is measured."""

import numpy as np
import pytest

from kc2spice.core.waveforms import Waveforms
from kc2spice.workflow.verify.compare import Solution, metric_errors


def test_a_metric_without_unit_is_judged_by_itself_and_not_by_frequencies():
    waves = Waveforms({"frequency": np.array([1.0, 1e5]), "z": np.array([2.0, 3.0])}, {})
    units = {"z": "Ohm"}
    ours = Solution(waves, {"coupling": 0.33, "least_ohm": 1e-4, "zero": 0.25})
    exact = Solution(waves, {"coupling": 0.30, "least_ohm": 2e-4, "zero": 0.0})
    found = dict(metric_errors(ours, exact, units))
    assert found["coupling"] == pytest.approx(0.1)
    assert found["least_ohm"] == pytest.approx(1e-4 / 3e-3)  # a thousandth of the largest
    assert found["zero"] == 0.25
