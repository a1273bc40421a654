"""The benchmark's quick run: the record's shape, and errors that are errors; never times."""

import json
import math

import pytest
from commands import python
from support import UsageError

from bench.__main__ import PARTS
from bench.__main__ import bench as bench_of

pytestmark = pytest.mark.slow  # other programs, every scene

RATIOS = {
    "loop_cpu_s", "loop_vs_scipy", "loop_vs_scipy_specialised", "loop_vs_floor", "harmonic",
    "imprint_refactor", "imprint_low_rank", "impact_refactor", "impact_low_rank",
    "em_superposition", "dense_vs_resonator_30", "dense_vs_resonator_348", "start_help_s",
    "start_rerun_s", "start_first_s", "scikit_rf_vs_ours_ac", "scikit_rf_vs_ours_tran",
    "resonators_vs_states_ac", "resonators_vs_states_tran",
}  # fmt: skip
PLANES = {"loop", "impact", "imprint", "harmonic", "em", "dense", "writers"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench")
    python(out, "-m", "bench", "--quick", "--repeats", "1", "--out", str(out))
    return json.loads((out / "bench.json").read_text()), out


def points(record, plane):
    return {point["label"]: point for point in record["planes"][plane]}


def test_record_has_the_contracts_shape(bench):
    record, out = bench
    assert set(record["planes"]) == PLANES
    assert set(record["ratios"]) == RATIOS
    assert {"cpu", "cores", "os", "python", "numpy", "scipy", "ngspice"} <= set(record["machine"])
    for name, found in record["planes"].items():
        assert found, name
        for point in found:
            assert math.isfinite(point["error"])
            assert point["error"] >= 0
            assert point["time_low_s"] <= point["time_s"] <= point["time_high_s"]
        assert any(point["pareto"] for point in found)
    for ratio in record["ratios"].values():
        assert {"value", "error", "target", "met", "what"} <= set(ratio)
    for file in ("bench.md", "bench_loop.png"):
        assert (out / file).stat().st_size > 500


def test_errors_decrease_with_finer_settings(bench):
    record, _ = bench
    loop, harmonic = points(record, "loop"), points(record, "harmonic")
    assert 0 < loop["trap, reltol 0.0001"]["error"] < loop["trap, reltol 0.001"]["error"]
    assert 0 < loop["Radau, rtol 0.0001"]["error"] < loop["Radau, rtol 0.001"]["error"]
    # the steps of the paper cost more than a tenth of the launch velocity
    assert loop["fixed 10 us steps, as in the paper"]["error"] > 0.1
    assert loop["lower bound"]["error"] < 1e-5
    tight, loose = (harmonic[f"tolerance {t}"]["error"] for t in ("1e-06", "0.01"))
    assert 0 < tight <= 1e-6
    assert 1e-6 < loose <= 1e-2
    em = points(record, "em")
    assert 0 < em["9 heights"]["error"] < em["5 heights"]["error"]


def test_methods_that_must_agree_do(bench):
    record, _ = bench
    assert record["ratios"]["em_superposition"]["error"] < 1e-11
    assert record["ratios"]["imprint_low_rank"]["error"] < 1e-9
    for point in record["planes"]["dense"]:
        assert point["error"] < 1e-9
    impact = points(record, "impact")
    assert impact["full model, low rank"]["error"] == impact["full model, refactorising"]["error"]


def test_the_table_of_sizes_is_made_by_the_documented_command(tmp_path):
    words = ("-m", "bench.reduction_scaling", "--sizes", "300", "900")
    said = python(tmp_path, *words)
    rows = [line.split("|") for line in said.splitlines() if "| plate |" in line]
    assert [int(row[2]) for row in rows] == [300, 867]
    assert all(float(row[8]) > 0 for row in rows)  # CPU relative to the lower bound


def test_parts_can_be_chosen_and_wrong_ones_are_named(tmp_path):
    with pytest.raises(UsageError) as caught:
        bench_of(tmp_path / "out", ["loops"], quick=True, repeats=1)
    assert all(part in str(caught.value) for part in ("--part", "loops", *PARTS))
    assert not (tmp_path / "out").exists()
