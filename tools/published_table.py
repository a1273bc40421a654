"""Write docs/evidence/devices.md: published values beside the values of three models.

python tools/published_table.py [SCENE ...]

Every device is a built-in scene or a scene in docs/published. No property of a device is fitted.
The program computes the rows of the named scenes and copies all other rows and pictures from the
old page. Without names it computes all rows in some minutes.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from docs_numbers import date_and_commit

from kc2spice.bodies.impedance import analyse_impedance
from kc2spice.core.figure import Curve, Figure, Panel, get_axis_label_and_factor
from kc2spice.core.progress import StageTimer
from kc2spice.report.matplotlib_figures import write_pngs
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Scene
from kc2spice.workflow.part_models import build_models
from kc2spice.workflow.run import run_scene
from kc2spice.workflow.verify.scene_verification import verify_scenes

ROOT = Path(__file__).parents[1]
CASES = ROOT / "docs" / "published"
UNITS = {
    "resonance_hz": ("resonance", 1e3, "kHz"),
    "capacitance_f": ("capacitance", 1e-9, "nF"),
    "feedback_capacitance_f": ("feedback capacitance", 1e-9, "nF"),
    "tone_hz": ("tone", 1e3, "kHz"),
    "launch_velocity_m_s": ("launch speed", 1.0, "m/s"),
    "sub_impacts": ("contacts in one blow", 1.0, ""),
    "antiresonance_hz": ("antiresonance", 1e3, "kHz"),
    "gap_stiffness_n_m": ("stiffness of the film", 1e3, "N/mm"),
    "gap_damping_n_s_m": ("damping of the film", 1e-3, "mN s/m"),
}
SUFFIXES = {
    "_m_s": "m/s", "_m": "m", "_n": "N", "_s": "s", "_v": "V", "_a": "A", "_hz": "Hz",
    "_siemens": "S", "_k": "K", "_db": "dB", "_ohm": "Ω", "_pa": "Pa",
}  # fmt: skip
PLACE_UNITS = {
    "us": "µs",
    "ms": "ms",
    "hz": "Hz",
    "khz": "kHz",
    "um": "µm",
    "nm": "nm",
    "v": "V",
    "s": "s",
}
# The place at the end of a metric's name: at_180us, first_at_1_5hz, back_at_14p5_v.
PLACE = re.compile(rf"_(\d+)(?:[p_](\d+))?_?({'|'.join(PLACE_UNITS)})$")
PREFIXES = ((1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
PICTURES = {
    "buzzer_ft_20t_6_5a1": "disc_impedance.png",
    "stack_p882": "stack_impedance.png",
    "buzzer_square": "disc_ports.png",
    "buzzer_self": "disc_ports.png",
    "harvester": "beam_response.png",
    "harvester_bridge": "beam_deformed.png",
    "sphere_on_beam": "contact_force.png",
    "kick_slew": "sphere_trajectory.png",
}
EDGES = (0.1, 1.0, 5.0, 10.0, 20.0)  # us, of the kick's drive
HEAD = """# Devices with published numbers

The tables compare results of kc2spice with published values of devices. The models use material
constants from textbooks, and dimensions from the data sheet or paper. No property is fitted to the
published values. If a property is fitted to another measurement of the same device, the row states
this measurement. `kc2spice run NAME` runs a built-in scene. Scenes that are not built in are files
in `docs/published`. `kc2spice explain NAME` prints the error estimate of the mesh.

The words in italics are columns of the tables, or marks in the tables:

- *full*: value of the finite-element model.
- *reduced*: value of the reduced model, which becomes the subcircuit.
- *ngspice*: value that ngspice computes from the netlist of the scene.
- *difference*: relative difference between the ngspice value and the published value. In rows
  without an ngspice value, the column *difference* contains the relative difference between the
  value of the full model and the published value.
- *within*: "yes" if the difference is at most the tolerance of the published value.
- A dash marks a value that does not apply.
- *measured*: the published value was measured on one device. Published values without this mark
  come from data sheets, closed-form solutions, or finite-element results of other programs.
- *assumed*: the source does not state an input of the model, so the computed value depends on an
  assumption.

The models of the discs have no supports. The discs of the data sheets are supported at a nodal
circle, and the support changes the resonance by 0.1 %. In scenes with a transient analysis,
kc2spice computes the values *full* and *reduced* by time integration in scipy, without ngspice.
`python tools/published_table.py` writes this page from `docs/published.toml`.

{origin}

"""
TABLE_HEAD = """\
| scene | quantity | published | full | reduced | ngspice | difference | within |
|---|---|---|---|---|---|---|---|"""
# Heading of each table, and the ends of the names of its metrics. The first match counts.
TABLES = {
    "Resonances and other frequencies": ("_hz",),
    "Capacitances and admittances": ("_f", "_siemens"),
    "Velocities, forces and numbers of contacts": ("_m_s", "_n", "impacts"),
    "Stiffness and damping": ("_n_m", "_n_s_m"),
    "Displacements and heights": ("_m",),
    "Times": ("_s",),
    "Voltages and currents": ("_v", "_a"),
    "Temperature rises": ("_k",),
    "Electrical impedances": ("_ohm",),
    "Sound pressures": ("_pa",),
    "Sound pressure levels": ("_db",),
}
ASSUMPTIONS = (
    "For the scenes in the next list, the sources do not state every input of the model. The list "
    "states the assumed values. Table rows that depend on an assumed value do not test the model."
)
KICKS = """\
The next table shows results of the scene `kick_slew` for different rise times (edges) of the drive
voltage. With an edge of about 20 µs, the computed speed of the sphere is close to the measured
speed of 0.243 m/s. In the scene `kick_and_catch`, the sphere has a diameter of 2 mm, and each edge
of the drive voltage lasts 0.1 µs. In the scene `kick_and_catch`, a launch velocity of 1.02 m/s
requires a driver current of 35 A. A driver with a smaller current charges the capacitance of the
chip more slowly, and the launch velocity is lower."""
SOURCES = """\
The column *numbers from* states the file or text from which the published numbers were copied. The
files `vmNNN.dat` (verification manual of Ansys) are in `src/ansys/mapdl/core/examples/verif` of
<https://github.com/ansys/pymapdl>. The Murata catalogue of May 2014 was published at
`www1.futureelectronics.com/doc/Murata/7BB-20-6-MUR.pdf`."""
SOURCES_HEAD = "| scene | device | source | numbers from |\n|---|---|---|---|"


@dataclass(frozen=True)
class Answer:
    """One quantity (SI) by three solution paths, None where a path cannot give it."""

    full: float | None
    reduced: float | None
    ngspice: float | None

    @property
    def best(self) -> float:
        """Computed value that is compared with the published number."""
        found = self.ngspice if self.ngspice is not None else self.full
        assert found is not None
        return found


def simulate(name: str, *overrides: str) -> tuple[dict[str, Any], dict[str, np.ndarray], Path]:
    """Record, waveforms and folder of a run."""
    out = Path(tempfile.mkdtemp()) / name
    record = run_scene(load_scene(name, list(overrides)), out, png=True)
    with np.load(out / "waveforms.npz", allow_pickle=False) as waves:
        return record, dict(waves), out


def models(scene: Scene, part: str) -> tuple[LinearModel, LinearModel]:
    """Full and reduced model of a body."""
    clock = StageTimer()
    body: Any = scene.parts[part]
    full = body.type.make_full_model(body, scene, clock)
    return full, build_models(scene, clock).model(body, LinearModel)


Solver: TypeAlias = Callable[[str, Mapping[str, Any]], tuple[dict[str, Answer], Path]]


@dataclass(frozen=True)
class Analyser:
    """A body in front of an impedance analyser: full model, figures of the reduced one and of
    ngspice, folder of the run."""

    full: LinearModel
    reduced: Mapping[str, Any]
    ngspice: Mapping[str, Any]
    out: Path


def analysed(name: str, part: str) -> Analyser:
    """Values of an impedance analyser for a body whose scene is an ac analysis."""
    full, reduced = models(load_scene(name, []), part)
    record, waves, out = simulate(name)
    frequency = waves["frequency"].real
    at = [port.name for port in reduced.ports].index("anode")
    charge = reduced.transfer(frequency)[:, at, at]
    read = asdict(analyse_impedance(frequency, 1 / (2j * np.pi * frequency * charge)))
    return Analyser(full, read, record["metrics"], out)


def buzzer(name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Answer], Path]:
    """Impedance of a diaphragm."""
    seen = analysed(name, "disc")
    facts = seen.full.facts
    found = {
        quantity: Answer(facts[fact], seen.reduced[quantity], seen.ngspice[quantity])
        for quantity, fact in (
            ("resonance_hz", "resonance_short_hz"), ("capacitance_f", "capacitance_free_f"),
        )
    }  # fmt: skip
    if "feedback_capacitance_f" in entry:
        fact = "feedback_capacitance_f"
        found[fact] = Answer(facts[fact], None, None)
    return found, seen.out


def metrics(name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Answer], Path]:
    """Metrics of a scene of the gallery."""
    record, _, out = simulate(name)
    of_run = record["metrics"]
    return {key: Answer(None, None, of_run[key]) for key in quantities(entry)}, out


def tone(name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Answer], Path]:
    """Frequency of the self-oscillating circuit."""
    record, _, out = simulate(name)
    return {"tone_hz": Answer(None, None, record["metrics"]["tone_hz"])}, out


def kick(name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Answer], Path]:
    """Speed at which the sphere leaves."""
    record, _, out = simulate(name)
    speed = record["metrics"]["launch_velocity_m_s"]
    return {"launch_velocity_m_s": Answer(None, None, speed)}, out


def blow(name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Answer], Path]:
    """How often the sphere strikes."""
    _, waves, out = simulate(name)
    loaded_ = waves["contact.force"] > 1e-6 * waves["contact.force"].max()
    count = int(np.count_nonzero(loaded_[1:] & ~loaded_[:-1]) + loaded_[0])
    return {"sub_impacts": Answer(None, None, float(count))}, out


def case(name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Answer], Path]:
    """A scene of docs/published by its metrics; with ``full = false`` by ngspice alone."""
    scene = load_scene(str(CASES / entry["scene"]), entry.get("set", []))
    out = Path(tempfile.mkdtemp()) / name
    if entry.get("full", True):
        answers = verify_scenes([scene], out)["scenes"][scene.name]["answers"]
    else:
        answers = {"ngspice": run_scene(scene, out)["metrics"]}
    paths = [answers.get(path, {}) for path in ("fom", "rom", "ngspice")]
    return {key: Answer(*(path.get(key) for path in paths)) for key in quantities(entry)}, out


def solver(name: str, entry: Mapping[str, Any]) -> Solver:
    """Function that computes the values of a device."""
    return case if "scene" in entry else SOLVERS.get(name, buzzer)


def shown(quantity: str) -> tuple[str, float, str]:
    """Words, factor to SI and unit of a quantity."""
    if quantity in UNITS:
        return UNITS[quantity]
    suffix = next(s for s in SUFFIXES if quantity.endswith(s))
    words = quantity.removesuffix(suffix)
    if place := PLACE.search(words):
        whole, decimals, unit = place.groups()
        number = f"{whole}.{decimals}" if decimals else whole
        words = f"{words[: place.start()]}_{number} {PLACE_UNITS[unit]}"
    return re.sub(r"(?<=[a-z])(\d+)$", r" \1", words).replace("_", " "), 1.0, SUFFIXES[suffix]


SOLVERS: dict[str, Solver] = {
    "buzzer_self": tone, "kick_slew": kick, "sphere_on_beam": blow, "air_transducer": metrics,
    "sounder_in_housing": metrics, "alarm_3v": metrics,
}  # fmt: skip


def table_of(quantity: str) -> str:
    """Heading of the table that contains a quantity."""
    for heading, ends in TABLES.items():
        if quantity.endswith(ends):
            return heading
    raise ValueError(f"no table for the quantity {quantity}")


def divide_rows(published: Mapping[str, Any], lines: Sequence[str]) -> str:
    """Return one table for each kind of quantity, with the rows in ``lines``."""
    headings = {
        f"| `{name}` | {scaled(entry, quantity)[0]} |": table_of(quantity)
        for name, entry in published.items()
        for quantity in quantities(entry)
    }
    tables: dict[str, list[str]] = {heading: [] for heading in TABLES}
    for line in lines:
        start = "|".join(line.split("|")[:3]) + "|"
        tables[headings[start]].append(line)
    return "\n\n".join(
        "\n".join([f"### {heading}\n", TABLE_HEAD, *members])
        for heading, members in tables.items()
        if members
    )


def quantities(entry: Mapping[str, Any]) -> list[str]:
    """Names of the published metrics of a device."""
    return [key for key, value in entry.items() if isinstance(value, dict) and "value" in value]


def scaled(entry: Mapping[str, Any], quantity: str) -> tuple[str, float, str]:
    """Words, factor to SI and unit, with the prefix that suits the published value."""
    label, unit, text = shown(quantity)
    label = entry[quantity].get("label", label)
    if quantity in UNITS or not text:
        return label, unit, text
    size = abs(entry[quantity]["value"])
    factor, prefix = next(p for p in PREFIXES if size >= p[0] or p is PREFIXES[-1])
    return label, factor, prefix + text


def rows(name: str, entry: Mapping[str, Any], found: Mapping[str, Answer]) -> list[str]:
    """One row a quantity."""
    lines = []
    for quantity, answer in found.items():
        label, unit, text = scaled(entry, quantity)
        sheet = entry[quantity]
        difference = answer.best / sheet["value"] - 1
        level = text == "dB"  # differences of levels are no ratios
        inside = abs(difference) <= sheet["tolerance"]
        limit = f"{sheet['value'] / unit:.3g} {text} ± {100 * sheet['tolerance']:.3g} %"
        if level:
            limit = f"{sheet['value']:.6g} dB ± {sheet['tolerance'] * sheet['value']:.2g} dB"
        if sheet.get("at_least"):
            inside, limit = answer.best >= sheet["value"], f"at least {sheet['value']}"
        if entry.get("measured"):
            limit += ", measured"
        values = (answer.full, answer.reduced, answer.ngspice)
        verdict = "yes" if inside else "**no**"
        if entry.get("assumed"):
            verdict += ", assumed"
        digits = 6 if level else 4
        cells = ["-" if v is None else f"{v / unit:.{digits}g} {text}".strip() for v in values]
        off = f"{answer.best - sheet['value']:+.3f} dB" if level else percent(difference)
        lines.append(
            f"| `{name}` | {label} | {limit} | {' | '.join(cells)} "
            f"| {'' if sheet.get('at_least') else off} | {verdict} |"
        )
    return lines


def percent(share: float) -> str:
    """A share in percent with its sign, without that of a zero."""
    text = f"{100 * share:+.1f} %"
    return text[1:] if float(text[:-2]) == 0 else text


def slew() -> list[str]:
    """Table of the kick over the edge of the drive."""
    lines = ["| edge | slew | speed | height | peak current |", "|---|---|---|---|---|"]
    for edge in EDGES:
        metrics = simulate("kick_slew", f"kick.drive.edge={edge} us")[0]["metrics"]
        speed = metrics["launch_velocity_m_s"]
        lines.append(
            f"| {edge:g} µs | {100 / edge:.3g} V/µs | {speed:.3f} m/s "
            f"| {1e3 * speed**2 / 2 / 9.81:.3g} mm | {metrics['peak_current_a']:.3g} A |"
        )
    return lines


def page(published: Mapping[str, Any], names: Collection[str], old: str) -> str:
    """Return the new page and copy its pictures.

    Rows of scenes that are not among the ``names`` are copied from the ``old`` page.
    """
    figures = ROOT / "docs" / "figures" / "devices"
    figures.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    old_rows = old.partition("\n## ")[0].splitlines()
    shared = {name: load_scene(name, []).title for name in PICTURES.keys() - published.keys()}
    for name, entry in published.items():
        if name not in names:
            lines += [line for line in old_rows if line.startswith(f"| `{name}` |")]
            continue
        found, out = solver(name, entry)(name, entry)
        lines += rows(name, entry, found)
        _picture(name, out, figures)
        drawn(name, entry, figures)
    for name in shared.keys() & set(names):
        _, _, out = simulate(name, *(["beam.fields=true"] if name == "harvester_bridge" else []))
        _picture(name, out, figures)
    titles = {name: entry["device"] for name, entry in published.items()} | shared
    pictures = [
        f"`{name}`: {title}\n\n![{title}](../figures/devices/{name}.png)"
        for name, title in titles.items()
        if name in PICTURES or "curve" in published.get(name, {})
    ]
    edges = ["| edge |" + old.split("| edge |")[1].split("\n\n")[0]]
    if "kick_slew" in names:
        edges = slew()
    reasons = [
        f"- `{name}`, {scaled(entry, quantity)[0]}: {reason}."
        for name, entry in published.items()
        for quantity, reason in entry.get("misses", {}).items()
    ]
    assumed = [
        f"- `{name}`: {entry['assumed']}."
        for name, entry in published.items()
        if "assumed" in entry
    ]
    sources = [
        f"| `{name}` | {entry['device']} | {entry['source']} | {entry['checked']} |"
        for name, entry in published.items()
    ]
    parts = [
        divide_rows(published, lines), "## Values outside of the tolerance", "\n".join(reasons),
        "## Assumptions", ASSUMPTIONS, "\n".join(assumed),
        "## Kick height versus slew rate of the driver", KICKS, "\n".join(edges),
        "## Pictures", "\n\n".join(sorted(pictures)),
        "## Sources", SOURCES, "\n".join([SOURCES_HEAD, *sources]),
    ]  # fmt: skip
    return HEAD.format(origin=origin(published, names, old)) + "\n\n".join(parts) + "\n"


def origin(published: Mapping[str, Any], names: Collection[str], old: str) -> str:
    """Date and commit of the whole page; that of the ``old`` one if only some rows are new."""
    earlier = re.search(r"(?m)^All rows were computed .*$", old)
    if not published.keys() <= set(names):
        return (
            earlier[0]
            if earlier
            else "The rows come from several runs, so the page has no common date."
        )
    return f"All rows were computed {date_and_commit()}."


def drawn(name: str, entry: Mapping[str, Any], figures: Path) -> None:
    """Published points of ``curve = { of, points, … }`` over the scene's wave ``of``, as a file.

    ``points`` are pairs of a place on the scale (s, Hz, what a dc analysis sweeps, or the wave
    ``against``) and a value, both in SI; ``x`` and ``y`` are labels, ``x_factor`` and ``factor``
    what their units take of SI; ``log`` a logarithmic axis. Complex waves are drawn by their size.
    """
    if "curve" not in entry:
        return
    plan, out = entry["curve"], Path(tempfile.mkdtemp()) / name
    run_scene(load_scene(str(CASES / entry["scene"]), entry.get("set", [])), out)
    with np.load(out / "waveforms.npz", allow_pickle=False) as waves:
        scale = plan.get("against", next(iter(waves)))
        x, y = waves[scale].real, waves[plan["of"]]
    x_label, unit = get_axis_label_and_factor(scale, x)
    at, values = np.array(plan["points"], dtype=float).T
    factor, y = plan.get("factor", 1.0), np.abs(y) if np.iscomplexobj(y) else y
    unit = plan.get("x_factor", unit)
    curves = (
        Curve("predicted", unit * x, factor * y),
        Curve("published", unit * at, factor * values, "o"),
    )
    panel = Panel(plan.get("x", x_label), plan["y"], curves, log_y=plan.get("log", False))
    write_pngs(figures, [Figure(name, entry["device"], "", (panel,))])


def _picture(name: str, out: Path, figures: Path) -> None:
    if name in PICTURES:
        shutil.copy(out / PICTURES[name], figures / f"{name}.png")


def main(names: list[str]) -> None:
    """Write the page; ``names`` are the scenes to compute again."""
    published = tomllib.loads((ROOT / "docs" / "published.toml").read_text("utf-8"))
    path = ROOT / "docs" / "evidence" / "devices.md"
    new = page(published, names or {**published, **PICTURES}, path.read_text("utf-8"))
    path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
