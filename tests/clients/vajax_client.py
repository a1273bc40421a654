"""Runs a module in a circuit with fixed steps: vajax_client.py MODULE.va SIM STEP STOP NPZ"""

import sys
from pathlib import Path

import numpy as np
from vajax import CircuitEngine, configure_precision
from vajax.analysis.openvaf_models import MODEL_PATHS
from vajax.analysis.transient import AdaptiveConfig

module, circuit, step, stop, out = sys.argv[1:]
configure_precision(force_x64=True)
MODEL_PATHS[Path(module).stem] = ("bundled", str(Path(module).resolve()))
engine = CircuitEngine(Path(circuit))
engine.parse()
fixed = AdaptiveConfig(min_dt=float(step), max_dt=float(step))
engine.prepare(t_stop=float(stop), dt=float(step), adaptive_config=fixed)
result = engine.run_transient()
np.savez(out, time=result.times, **{name: result.voltage(name) for name in result.node_names})
