"""Error budget: say what error is acceptable; runs are refined until the estimate holds it."""

import kc2spice as kc

layer = {"material": "PZT-5A", "thickness": "0.3 mm"}
tables = {
    "name": "bender",
    "beam": {"part": "bimorph", "length": "30 mm", "width": "5 mm", "layers": [layer, layer],
             "wiring": "parallel", "damping": {"quality": 50}, "pins": {"anode": "drive.out"}},
    "drive": {"part": "source",
              "pulse": {"high": "50 V", "start": "0.1 ms", "width": "2 ms", "edge": "50 us"}},
    "analysis": {"type": "transient", "stop": "5 ms"},
    "rom": {"band": ["0 Hz", "100 kHz"]},  # edges of 50 us excite no more
    "probes": {"stroke_m": {"of": "beam.u.tip", "take": "max"}},
}  # fmt: skip
exact = kc.run(kc.load_scene(tables, {"solver.reltol": 1e-6, "rom.tolerance": 1e-5}))
result = kc.run(kc.load_scene(tables, {"error_budget": 1e-3}))
error = result.metrics["stroke_m"] / exact.metrics["stroke_m"] - 1
print(f"error {error:.1e} with {result.record['rom']['order']} states, "
      f"{result.time.size} time points instead of {exact.time.size}")  # fmt: skip
assert abs(error) < 1e-3

for row in result.record["convergence"]["tried"]:  # what was refined, and each estimate
    print(row["settings"] or "as it is", max(row["errors"].values()))
