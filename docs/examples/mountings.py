"""Mountings: sound pressure levels of eleven buzzer discs, free, on rings and in a housing.

The support ring of each disc is the nodal circle of its mode without a support: the circle that
does not move at the resonance with the largest level.
"""

import copy
import math
import warnings

import kc2spice as kc

DISCS = [f"buzzer_7bb_{size}" for size in ("12_9", "15_6", "20_3", "20_6", "27_4", "35_3")]
DISCS += [f"buzzer_ft_{size}" for size in ("15t_5_5a1", "20t_6_5a1", "27t_4_3a1", "35t_1_8a1")]
DISCS += ["buzzer_ft_39t_2_5b1"]
SOUND_SPEED, HOLE_LENGTH, RIM = 343.2, 1e-3, "simply_supported"
LEVEL, FREQUENCY, NODE = "peak_level_db", "peak_level_frequency_hz", "nodal_circle_m"
SHIFT = 0.05  # relative change of the diameter of the support ring


def on_ring(scene, diameter, resonance):
    """The disc on a ring of this diameter, near its resonance."""
    ends = {"analysis.start": 0.4 * resonance, "analysis.stop": 1.4 * resonance}
    return kc.run(scene, overrides={"disc.support": {"node": diameter}, **ends})


def in_housing(scene, resonance):
    """A cavity in front of the disc and a hole, tuned to the resonance of the disc on its rim."""
    tables = copy.deepcopy(dict(scene.tables))
    radius = 0.15 * scene.get_part("front").keys.surface_radius
    area, length = math.pi * radius**2, HOLE_LENGTH + 1.7 * radius
    volume = area / length * (SOUND_SPEED / (2 * math.pi * resonance)) ** 2
    tables["chamber"] = {"part": "cavity", "volume": volume}
    tables["hole"] = {
        "part": "vent", "radius": radius, "length": HOLE_LENGTH, "end_b": "none",
        "pins": {"a": "chamber.a", "b": "front.face"},
    }  # fmt: skip
    tables["front"] = {"part": "radiation", "radius": radius}
    tables["disc"]["pins"]["front_face"] = "chamber.a"
    tables["disc"]["support"] = RIM
    tables["rom"] = {"tolerance": 1e-3, "band": [0.2 * resonance, 3 * resonance]}
    tables["analysis"] |= {"start": 0.4 * resonance, "stop": 1.4 * resonance}
    return tables


def without_baffle(result):
    """Change of the level [dB] without a baffle, from the assumptions of the run."""
    rows = {row["effect"]: row["error"] for row in result.record["plan"]["left_out"]}
    words = rows.get("disc: baffle of front_face", "unknown").split()
    return f"{words[1]:>5}" if words[0] == "about" else "    -"


warnings.simplefilter("ignore")  # no disc moves like a piston
print("level in dB at 100 mm and 1 V amplitude, frequency in kHz, change of the level in dB")
print("                     free            no baffle  on a ring      on its rim     in a housing")
rings, errors = [], []
for name in DISCS:
    scene = kc.load_scene(name)
    free = kc.run(scene)
    resonance, node = free.metrics[FREQUENCY], free.metrics[NODE]
    ring, *others = (on_ring(scene, node * (1 + s), resonance) for s in (0.0, -SHIFT, SHIFT))
    rim = kc.run(scene, overrides={"disc.support": RIM})
    housed = kc.run(in_housing(scene, rim.metrics[FREQUENCY]))
    runs = (free, ring, rim, housed)
    row = [f"{r.metrics[LEVEL]:5.1f} {1e-3 * r.metrics[FREQUENCY]:6.3f}" for r in runs]
    assert abs(ring.metrics[FREQUENCY] / resonance - 1) < 0.005
    assert rim.metrics[FREQUENCY] < resonance
    assert 60 < housed.metrics[LEVEL] < 110
    errors.append([run.metrics["level_error_db"] for run in runs])
    print(f"{name:20} {row[0]}   {without_baffle(free)}      {'  '.join(row[1:])}")
    smaller, larger = (other.metrics[LEVEL] - ring.metrics[LEVEL] for other in others)
    share = node / (2 * scene.get_part("front").keys.surface_radius)
    rings.append(
        f"{name:20} {1e3 * node:5.2f}   {share:.3f}      {smaller:+5.1f}     {larger:+5.1f}"
    )
free, ring, rim, housed = (f"{max(column):5.1f}" for column in zip(*errors, strict=True))
print(f"{'largest error':20} {free}                   {ring}          {rim}          {housed}")
print("\ndiameter of the support ring in mm, change of the level in dB")
print("                     ring   ring / disc  5 % smaller  5 % larger")
print("\n".join(rings))
