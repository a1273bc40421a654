"""A domain is one row: a made-up one works in parts, models, pins, headers, symbols and probes."""

import os
import re
import subprocess
import sys
from pathlib import Path

from support import PORTS

ROOT = Path(__file__).parents[2]
# Water under a head: 1 V is 1 kPa over the pin ``tank``, 1 A is 1 dm3/s.
ROW = """
WATER = Domain(
    "water",
    Quantity("head", "head", "Pa", "kPa", 1e3),
    Quantity("discharge", "discharge", "m3/s", "dm3/s", 1e-3),
    "across * through",
    "levels are constant",
    port="water",
    output_unit="m3",
    compliance="m3/Pa",
    output_symbol="head",
    output_wave="discharge",
    reference="tank",
    path_to_reference="a pipe to gnd",
    floating_error="no pipe leads from {part}",
)
TABLE = (WATER, """
START = f"""
import importlib.util, sys
from pathlib import Path

spec = importlib.util.find_spec("kc2spice.core.domains")
text = Path(spec.origin).read_text(encoding="utf-8")
assert text.count("TABLE = (") == 1
module = importlib.util.module_from_spec(spec)
sys.modules["kc2spice.core.domains"] = module
exec(compile(text.replace("TABLE = (", {ROW!r}), spec.origin, "exec"), module.__dict__)
"""
USE = '''
import numpy as np
import scipy

import kc2spice as kc
from kc2spice.netlist.printers.symbol_layout import arrange_pins
from kc2spice.netlist.printers.dialect_registry import list_dialect_names
from kc2spice.physics import Declaration, DeclaredPart, branch
from kc2spice.workflow.export import export_scene
from kc2spice.workflow.verify.scene_verification import verify_scenes


class PipeKeys(kc.Section):
    resistance: float


pipe = Declaration("pipe", "pipe", PipeKeys, (branch("head"),), content="0.5*head^2/resistance")
kc.register_part(DeclaredPart(pipe))

R, INERTIA, LOSS, STIFFNESS, ROOM = 4e5, 2e3, 3e5, 5e7, 1e-9  # SI
one = np.eye(1)
matrices = {"M": INERTIA * one, "E": LOSS * one, "K": STIFFNESS * one, "B": one, "D": ROOM * one}
for letter, matrix in matrices.items():
    scipy.io.mmwrite(f"surge.{letter}.mtx", matrix)
port = '[[ports]]\\nname = "mouth"\\nkind = "water"\\ncolumn = 1\\n'
Path("surge.toml").write_text("band = [0, 100]\\n" + port)
Path("network.toml").write_text("""
name = "network"
gravity = 0.0
[drive]
part = "source"
kind = "discharge"
ac = "2e-3 m3/s"
[pipe]
part = "pipe"
resistance = 4e5
pins = { a = "drive.out" }
[surge]
part = "matrices"
file = "surge"
pins = { mouth = "drive.out" }
[analysis]
type = "ac"
start = 1
stop = 50
points = 30
[probes]
lost = { of = "pipe.power", take = "max" }
into = { of = "surge.mouth.discharge", take = "max" }
taken = { of = "surge.mouth.power", take = "max" }
""")
scene = kc.load_scene("network.toml")
result = kc.run(scene)
s = 2j * np.pi * result.waves["frequency"].real
surge = 1 / (s * INERTIA + LOSS + STIFFNESS / s) + s * ROOM
head = 2e-3 / (1 / R + surge)
close = dict(rtol=1e-6)
np.testing.assert_allclose(result.waves["drive.head"], head, **close)
np.testing.assert_allclose(result.waves["surge.head.mouth"], head, **close)
np.testing.assert_allclose(result.waves["surge.mouth.discharge"], head * surge, **close)
np.testing.assert_allclose(result.waves["pipe.power"], abs(head) ** 2 / R / 2, **close)
power = (head * (head * surge).conj()).real / 2
np.testing.assert_allclose(result.waves["surge.mouth.power"], power, **close)
units = {"drive.head": "Pa", "surge.mouth.discharge": "m3/s", "pipe.power": "W"}
assert {name: result.units[name] for name in units} == units

for dialect in list_dialect_names():
    files = export_scene(scene, Path(dialect), dialect)
    text = "".join(p.read_text() for p in files if p.suffix in (".lib", ".va"))
    assert "mouth unit=kPa flow=dm3/s" in text
    assert "tank unit=kPa flow=dm3/s" in text
    assert "a unit=kPa flow=dm3/s" in text
part = next(part for part in result.deck.parts if "surge" in part.name)
sides = {place.name: place.side for place in arrange_pins(part).places}
assert sides["tank"] == "bottom" and sides["mouth"] == "left"

found = verify_scenes([scene], Path("verified"))["scenes"]["network"]
assert found["passed"], [check for check in found["checks"] if not check["passed"]]

steady = {
    "drive": {"part": "source", "kind": "discharge", "dc": "2e-3 m3/s"},
    "pipe": {"part": "pipe", "resistance": R, "pins": {"a": "drive.out"}},
    "analysis": {"type": "op"},
    "probes": {"lost_w": {"of": "pipe.power", "take": "final"}},
}
metrics = kc.run(steady).metrics
assert abs(metrics["lost_w"] - 4e-6 * R) < 1e-9 * R
print("as one row")
'''


def run(script, folder):
    """Text that a Python process prints, started in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def test_a_new_domain_is_one_row_of_the_table(tmp_path):
    assert run(START + USE, tmp_path).endswith("as one row\n")


def test_no_other_module_compares_with_the_name_of_a_kind_of_port():
    compared = re.compile(r'(?:==|!=|\bis|\bin) \(?"(' + "|".join(PORTS) + r')"')
    places = sorted((ROOT / "kc2spice").rglob("*.py"))
    texts = {place: place.read_text(encoding="utf-8") for place in places}
    found = {place.name: compared.findall(text) for place, text in texts.items()}
    assert not {name: kinds for name, kinds in found.items() if kinds}
