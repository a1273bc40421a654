"""Print a table of the committed benchmark: ratios of ``bench.json``, or the points of a plane.

python docs/evidence/scripts/benchmark.py ratios NAME ...
python docs/evidence/scripts/benchmark.py plane NAME
"""

import json
import sys
from pathlib import Path

from tables import power, print_table

from kc2spice.core.si_prefix_format import format_quantity

MEANING = {
    "start_help_s": "`kc2spice --help`",
    "start_rerun_s": "`kick_and_catch` with a new gain",
    "start_first_s": "`kick_and_catch` with an empty cache",
    "loop_cpu_s": "`kick_and_catch` in ngspice, CPU time, fastest setting within the errors",
    "loop_vs_scipy": "fastest general integrator of scipy over ngspice",
    "loop_vs_scipy_specialised": "integrator of scipy specialised for this loop over ngspice",
    "loop_vs_floor": "compiled lower bound over ngspice",
    "impact_low_rank": "impact: full model with one factorisation over ngspice",
    "impact_refactor": "impact: full model with a factorisation in each iteration over ngspice",
    "imprint_low_rank": "imprint: full model with one factorisation over reduced model",
    "imprint_refactor": "imprint: full model with a factorisation at each depth over reduced model",
    "harmonic": "200 frequencies, all responses: full model over reduced model",
    "em_superposition": "force table: all current pairs over superposition",
    "dense_vs_resonator_30": ".ac, 30 modes: dense netlist over resonators",
    "dense_vs_resonator_348": ".ac, 174 modes: dense netlist over resonators",
    "scikit_rf_vs_ours_ac": ".ac: netlist of scikit-rf over kc2spice, same poles",
    "scikit_rf_vs_ours_tran": ".tran: netlist of scikit-rf over kc2spice, same poles",
    "resonators_vs_states_ac": ".ac: 100 resonators over 100 first-order states",
    "resonators_vs_states_tran": ".tran: 100 resonators over 100 first-order states",
}
RECORD = json.loads((Path(__file__).parents[1] / "bench" / "bench.json").read_text("utf-8"))


def ratio(name: str) -> list[str]:
    """Value, target and error of one figure."""
    found = RECORD["ratios"][name]
    value, target = (
        "" if found[key] is None else format_quantity(found[key], found["unit"], 3)
        for key in ("value", "target")
    )
    sign = "≥ " if found["at_least"] else "≤ "
    error = "" if found["error"] is None else power(found["error"])
    return [f"`{name}`", MEANING[name], value, target and sign + target, error]


def point(found: dict) -> list[str]:
    """Error and median time of one setting."""
    return [found["label"], power(found["error"]), format_quantity(found["time_s"], "s", 3)]


if __name__ == "__main__":
    kind, *names = sys.argv[1:]
    if kind == "ratios":
        head = ["figure", "meaning", "value", "target", "error"]
        print_table(head, map(ratio, names or RECORD["ratios"]))
    else:
        print_table(["setting", "error", "time"], map(point, RECORD["planes"][names[0]]))
