"""Parameters in a netlist: a thousand buzzers by ngspice alone, against finite elements."""

import re
import subprocess
import time
from pathlib import Path

import numpy as np

import kc2spice as kc

home = Path(__file__).parent / "monte_carlo"
scene = kc.load_scene(home / "buzzer.toml")
(library,) = kc.deck(scene).parts
library.write("buzzer_disc.lib")

loops = """* a thousand buzzers
.include buzzer_disc.lib
.param thickness=120e-6 modulus=110e9
Xdisc anode 0 0 buzzer_disc layers_1_thickness={thickness}
+ layers_0_material_youngs_modulus={modulus}
Vdrive anode 0 dc 0 ac 1
.control
set numdgt=10
setplot const
let k = 0
let point = vector(2)
dowhile k < 1000
  let t = 101e-6 + 38e-6*floor(k/25)/39
  let y = 96e9 + 28e9*(k - 25*floor(k/25))/24
  set t = $&t
  set y = $&y
  alterparam thickness=$t
  alterparam modulus=$y
  reset
  ac lin 401 2.5k 4.5k
  let conductance = -real(i(vdrive))
  meas ac peak MAX conductance
  destroy
  setplot const
  let k = k + 1
end
.endc
.end
"""
Path("sweep.cir").write_text(loops)
start = time.perf_counter()
log = subprocess.run(["ngspice", "-b", "sweep.cir"], capture_output=True, text=True).stdout
swept = time.perf_counter() - start
peaks = np.array([float(word) for word in re.findall(r"^peak\s*=\s*(\S+)", log, re.M)])
assert peaks.size == 1000, log[-2000:]

f = np.linspace(2.5e3, 4.5e3, 401)
chosen, error = range(37, 1000, 107), 0.0
start = time.perf_counter()
for k in chosen:
    values = {
        "disc.layers[1].thickness": 101e-6 + 38e-6 * (k // 25) / 39,
        "disc.layers[0].material.youngs_modulus": 96e9 + 28e9 * (k % 25) / 24,
    }
    fresh = kc.load_scene(scene, {**values, "disc.rom": {"tolerance": 1e-4, "band": [2e3, 5e3]}})
    Y = 2j * np.pi * f * kc.build(fresh)["disc"].select(["anode"]).transfer(f)[:, 0, 0]
    error = max(error, abs(peaks[k] / Y.real.max() - 1))
meshed = (time.perf_counter() - start) * 1000 / len(chosen)
print(f"1000 points: ngspice {swept:.2f} s, finite elements {meshed:.0f} s, "
      f"{meshed / swept:.0f} times; largest difference of the peak {error:.1e}")  # fmt: skip
assert error < 1e-2  # of which the meshes, which differ, make the most
