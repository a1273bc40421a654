"""Every part type that states its physics as expressions, by one test for all of them.

What is printed in each dialect is read back by ``networks`` and evaluated at random states;
so is the law of the independent integrator. Both are compared with derivatives of the stated
energies, taken by complex steps of their text. None of this shares code with the generators.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from networks import FUNCTIONS, H, Network
from support import TWO_TERMINAL_TABLE as TABLE
from support import (
    BuiltScene,
    ContactForce,
    Header,
    contact,
    find_dialect,
    format_module,
    law,
    list_dialect_names,
    list_gallery,
    load_part_types,
    load_scene,
    make_declared_subcircuit,
    parse_toml,
    write_dialect_files,
)

import kc2spice as kc

DECLARED = {n: kind for n, kind in load_part_types().items() if hasattr(kind, "declaration")}
DIALECTS = list_dialect_names()
PLAIN = {row.name for row in TABLE}  # cards of a deck, of which there is no module
PRINTED = [(n, d) for n in sorted(DECLARED) for d in DIALECTS if d != "verilog-a" or n not in PLAIN]
SIZES = {
    "displacement": (-7.0, -3.0),
    "voltage": (-1.0, 1.5),
    "current": (-3.0, 0.5),
    "temperature": (-1.0, 3.0),
    "pressure": (-2.0, 4.0),
    "volume_velocity": (-9.0, -4.0),
}
FLOWS = ("current", "volume_velocity")
PER_SI = {"displacement": 1e6, "volume_velocity": 1e6}  # volts or amperes of a coordinate
ANSWERED = {"pressure": 1e6}  # amperes for a unit of what flows


# --- what is stated, by complex steps of its text ----------------------------------------------


def quad(f, x):
    nodes, weights = np.polynomial.legendre.leggauss(60)
    return sum(w * f(x * (n + 1) / 2) for n, w in zip(nodes, weights, strict=True)) * x / 2


def stated(text, values):
    text = re.sub(r"integral\((.*), (\w+)\)", r"quad(lambda \2: \1, \2)", text.replace("^", "**"))
    return eval(text, {"quad": quad, **FUNCTIONS, **values})


def slope(text, values, name):
    return np.imag(stated(text, values | {name: values[name] + 1j * H})) / H


class Stated:
    """Through quantities of a declaration at a state and its rates."""

    def __init__(self, declaration, keys):
        self.d = declaration
        fields = type(keys).model_fields
        self.keys = {n: getattr(keys, n) for n in fields if isinstance(getattr(keys, n), float)}
        for name, text in declaration.constants.items():
            self.keys[name] = stated(text, self.keys)

    def inside(self, state):
        return all(stated(text, self.keys | state) > 0 for text in self.d.limits.values())

    def kept(self, branch, state):
        return slope(self.d.coenergy, self.keys | state, branch.name)

    def answer(self, branch, state, rates):
        """Force, current, or of a current branch its voltage."""
        known = self.keys | state | {f"{b.name}_rate": rates[b.name] for b in self.d.branches}
        if branch.kind == "displacement":
            held = slope(self.d.energy, known, branch.name)
            held -= slope(self.d.coenergy, known, branch.name)
            held += stated(self.d.forces.get(branch.name, "0"), known)
            return held + slope(self.d.content, known, f"{branch.name}_rate")
        rise = 0.0
        for name, x in state.items():
            places = [{**state, name: x * (1 + 1e-4 * k)} for k in (-2, -1, 1, 2)]
            kept = [self.kept(branch, place) for place in places]
            rise += (kept[0] - 8 * kept[1] + 8 * kept[2] - kept[3]) / (12e-4 * x) * rates[name]
        return rise + slope(self.d.content, known, branch.name)


# --- the comparison ------------------------------------------------------------------------------


def example(name):
    if given := load_part_types()[name].example:
        scene = load_scene({"name": "example", **parse_toml(given)})
    else:
        scene = next(each for each in map(load_scene, list_gallery()) if each.list_parts(name))
    return scene, scene.list_parts(name)[0]


def printed(name, dialect):
    """Library of the part, or its plain cards in the deck with pins as nodes."""
    scene, part = example(name)
    deck = kc.deck(scene)
    files = deck.files if dialect == "ngspice" else write_dialect_files(deck, dialect)
    own = [text for file, text in files.items() if file.startswith(f"{name}.")]
    if own:
        return own[0]
    text = "\n".join(files.values())
    lines = [line for line in text.splitlines() if line[:1] in tuple("RCLV") and name in line]
    nodes = {scene.get_net(part.name, pin): pin for pin in ("a", "b")}
    cards = [line.split() for line in lines if line[1:].startswith(name)]
    placed = [[c, nodes.get(a, a), nodes.get(b, b), *rest] for c, a, b, *rest in cards]
    return "\n".join(map(" ".join, placed))


def states(name, count=6):
    """Random states and rates within the limits, of all orders of size."""
    _, part = example(name)
    rng = np.random.default_rng(sum(map(ord, name)))
    stated_, found = Stated(part.type.declaration, part.keys), []
    while len(found) < count:
        state = {b.name: rng.choice([-1, 1]) * 10 ** rng.uniform(*SIZES[b.kind])
                 for b in part.type.declaration.branches}  # fmt: skip
        rates = {n: x * rng.uniform(-1e3, 1e3) for n, x in state.items()}
        if stated_.inside(state):
            found.append((state, rates))
    return stated_, found


def driven(branches, state, rates, rng):
    """Voltages and currents of the pins in the units of a netlist; ``minus`` is anywhere."""
    drives, changes = {}, {}
    for b in branches:
        unit = PER_SI.get(b.kind, 1.0)
        if b.minus not in drives:  # which branches may share
            drives[b.minus], changes[b.minus] = rng.uniform(-1, 1), rng.uniform(-1, 1)
        key = ("I", b.plus) if b.kind in FLOWS else b.plus
        base = (0.0, 0.0) if b.kind in FLOWS else (drives[b.minus], changes[b.minus])
        drives[key], changes[key] = base[0] + unit * state[b.name], base[1] + unit * rates[b.name]
    return drives, changes


def worst_printed(name, text):
    """Largest relative difference of a part's printed text from what it states."""
    stated_, found = states(name)
    branches, rng = stated_.d.branches, np.random.default_rng(1)
    keys = {n: stated_.keys[n] for n in stated_.keys if n not in stated_.d.constants}
    network, errors = Network(text, keys), []
    for state, rates in found:
        answers = network.answers(*driven(branches, state, rates, rng))
        for b in branches:
            exact = stated_.answer(b, state, rates)
            got = answers.get(f"I pin {b.plus}", 0.0) / ANSWERED.get(b.kind, 1.0)
            if b.kind in FLOWS:
                got = answers[b.plus] - answers[b.minus]
            errors.append(abs(got / exact - 1))
    return max(errors)


@pytest.mark.parametrize(("name", "dialect"), PRINTED)
def test_the_printed_text_equals_the_documented_text(name, dialect):
    """1e-9: a displacement of 0.1 um beside a pin at 1 um has lost a digit, and the oracle's
    differences of charges some more."""
    assert worst_printed(name, printed(name, dialect)) < 1e-9


def inputs(own, state, rates, drops):
    """Inputs of a law in the order of its across inputs and states, and their rates."""
    rows = [
        (drops[b.name], 0.0) if b.kind in FLOWS else (state[b.name], rates[b.name])
        for b in own.declaration.branches
    ]
    rows += [(rates[b.name], 0.0) for b in own.declaration.branches_with_rate]
    rows += [(state[n], rates[n]) for n in own.states]
    return np.array(rows).T


def get_law_name(name, **keys):
    scene, part = example(name)
    part = replace(part, keys=part.keys.model_copy(update=keys))
    laws = part.type.law(part, BuiltScene(scene, {})).laws
    (found,) = (law for law in laws if law.name == part.name)  # besides the law of a mass
    return found


def worst_law(name, **keys):
    """Largest relative difference of a part's law from what it states, and of its powers from each
    other."""
    own, (stated_, found) = get_law_name(name, **keys), states(name)
    errors, powers = [], []
    for state, rates in found:
        drops = {b.name: stated_.answer(b, state, rates) for b in stated_.d.branches
                 if b.kind in FLOWS}  # fmt: skip
        e, de = inputs(own, state, rates, drops)
        mode = own.find_initial_mode(e)
        out, _ = own.evaluate(e, mode)
        _, by = own.evaluate_storage(e, mode)
        rises, n = by @ de, len(own.states)
        through = out[: len(own.flows)].copy()
        through[list(own.storing_flow_indices)] += rises[n:]
        # a current's voltage changes its flux and drops: that is the residual of its row
        errors += [abs(out[len(own.flows) + k] / rises[k] - 1) for k in range(n)]
        brought, converted = 0.0, 0.0
        for k, b in enumerate(stated_.d.branches):
            exact = state[b.name] if b.kind in FLOWS else stated_.answer(b, state, rates)
            errors.append(abs(through[k] / exact - 1))
            across = rates[b.name] if b.kind == "displacement" else state[b.name]
            if b.kind in FLOWS:  # what its flux takes and what it drops
                place = own.states.index(b.name)
                across = rises[place] + drops[b.name] - out[len(own.flows) + place]
            brought += through[k] * across
            converted += abs(through[k] * across)
        stored, _ = own._energy_function(*(e + 1j * H * de), *mode, *own.values)
        rise, lost = np.imag(stored) / H, own.loss(e, mode)
        size = abs(brought) + abs(lost) + abs(rise)
        if not (stored or lost):  # an ideal transformer
            size = converted
        powers.append(abs(brought - rise - lost) / size)
    return max(errors), max(powers)


def worst_slope(name):
    """Largest relative difference of a law's Jacobians from complex steps of its functions."""
    own, (stated_, found) = get_law_name(name), states(name)
    errors = []
    for state, rates in found:
        drops = {b.name: 1.0 for b in stated_.d.branches}
        e, _ = inputs(own, state, rates, drops)
        mode = own.find_initial_mode(e)
        for made, (value, by) in (
            (own._flow_function, own.evaluate(e, mode)),
            (own._storage_function, own.evaluate_storage(e, mode)),
        ):  # fmt: skip
            for j in range(e.size):
                moved = made(*(e + 1j * H * np.eye(e.size)[j]), *mode, *own.values)
                exact = np.imag(np.array(moved[: len(value)], dtype=complex)) / H
                size = np.abs(by).max(initial=1e-300, axis=1)
                errors += list(np.abs(by[:, j] - exact) / size)
    return max(errors, default=0.0)


@pytest.mark.parametrize("name", sorted(set(DECLARED) - PLAIN))
def test_the_law_follows_its_declaration(name):
    """1e-9: the oracle's differences of charges, and rounding of the distances of plates that are a
    thousand times their gap apart; the energy is complete to rounding."""
    through, powers = worst_law(name)
    assert through < 1e-9
    assert powers < 1e-12
    assert worst_slope(name) < 1e-12


# --- masses, whose cards have the speed as a node of its own -------------------------------------

MOVING = {"mass": ("place_x", "speed_x"), "sphere": ("bottom", "v")}


def worst_motion(name, text):
    """Largest difference of a mass's cards from ``m (x'' + g) = F`` and ``x' = v``, relative."""
    m, g, place, speed = 2e-3, 9.0, *MOVING[name]
    network, rng, errors = Network(text, {"mass": m, "gravity": g}), np.random.default_rng(2), []
    for _ in range(6):
        x, v, rise, force, apart = rng.uniform(-1, 1, 5) * (1e-4, 2.0, 1e4, 5.0, 3.0)
        drives = {"base": 0.3, place: 0.3 + 1e6 * x, speed: 0.3 + v}
        rates = {"base": 0.0, place: 1e6 * v, speed: rise}
        wanted = {place: 0.0, speed: m * (rise + g)}
        if name == "mass":  # f_x is the force for which its own row, a = place, holds
            drives |= {"a": drives[place] + apart, "f_x": 0.3 + force}
            rates |= {"a": 0.0, "f_x": 0.0}
            wanted |= {speed: m * (rise + g) - force, "a": force, "f_x": -apart}
        answers = network.answers(drives, rates)
        errors += [abs(answers[f"I pin {pin}"] - exact) for pin, exact in wanted.items()]
        if name == "sphere":
            errors.append(abs(answers["y"] - drives[place] - 1e6 * example(name)[1].keys.radius))
    return max(errors)


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("name", MOVING)
def test_the_cards_of_a_mass_are_its_motion(name, dialect):
    """1e-9 of some newtons and metres a second: places are of a hundred micrometres."""
    text = printed(name, dialect)
    assert worst_motion(name, text) < 1e-9
    heavier = text.replace("{mass}", "{1.0001*mass}").replace("= mass*V", "= 1.0001*mass*V")
    assert worst_motion(name, heavier) > 1e-7


# --- contacts, whose declaration depends on the scene ---------------------------------------------

GAPS = (0.0, 2e-7)
CURVE = (1.0, 0.2, -0.1, 0.1, 0.0, 0.1)
NORMALS = {
    "linear": ContactForce(4e8), "hertz": ContactForce(1e10, 1.5),
    "damped": ContactForce(1e7, damping=0.5),
    "dry": ContactForce(1e10, 1.5, damping=0.5, friction=0.3, creep=1e-3),
    "pressure": ContactForce(1e9, 1.5, curve=CURVE, depth=1e-5, pace=1e-8, radius=1e-3),
}  # fmt: skip


def pressing(normal):
    return contact.declare_contact(("p", "q"), GAPS, normal, rigid=(False, False))


def touching(normal, count=20):
    """Random overlaps of two ports, their rates and the speed of sliding, and the forces there."""
    rng = np.random.default_rng(3)
    for _ in range(count):
        x, rate = rng.uniform(-1e-6, 3e-6, 2), rng.uniform(-5.0, 5.0, 2)
        slide, deep = rng.uniform(-3e-3, 3e-3), np.maximum(x, 0.0)
        if normal.pace:
            deep = np.maximum(x + normal.pace * rate, 0.0)
        root = np.sqrt(deep / normal.depth)
        force = normal.stiffness * deep**normal.power * np.polyval(normal.curve[::-1], root)
        force = force * np.maximum(0.0, 1.0 + normal.damping * rate)
        drag = normal.friction * force.sum() * np.clip(slide / normal.creep, -1, 1)
        yield x, rate, slide, [*force, *([drag] if normal.friction else [])]


def worst_cards(kind, dialect):
    """Largest difference of a contact's printed forces from its law, relative to the largest; at
    rest where they follow with a lag, whose square of time the cards leave out."""
    normal, made = NORMALS[kind], Header("law", "0")
    part = make_declared_subcircuit(made, "contact", pressing(normal), {})
    text = part.text
    if dialect == "verilog-a":
        (text,) = format_module(part).values()
    elif dialect != "ngspice":
        text = find_dialect(dialect)().format_file(part.circuit)
    values = {p.name: p.default for p in part.params}
    if normal.radius:  # the network has no lags
        normal = replace(normal, pace=0.0)
    network, errors = Network(text, values), []
    for x, rate, slide, wanted in touching(normal, 6):
        still = 0.0 if normal.radius else 1.0
        drives = {"base": 0.0, "b": 3.0, "rail": 0.2, "slide": 0.2}
        drives |= {"p": 3.0 + 1e6 * (x[0] + GAPS[0]), "q": 3.0 + 1e6 * (x[1] + GAPS[1])}
        rates = {**dict.fromkeys(drives, 0.0), "b": 1e5 * still, "slide": 1e6 * slide}
        rates |= {"p": still * (1e5 + 1e6 * rate[0]), "q": still * (1e5 + 1e6 * rate[1])}
        answers = network.answers(drives, rates)
        found = [answers[f"I pin {pin}"] for pin in ("p", "q", "slide")]
        size = max(map(abs, wanted)) or 1.0
        errors += [abs(a - b) / size for a, b in zip(found, wanted, strict=False)]
    return max(errors)


CARDS = [(kind, d) for kind in NORMALS for d in DIALECTS if (kind, d) != ("dry", "verilog-a")]


@pytest.mark.parametrize(("kind", "dialect"), CARDS)  # a module has no friction, which is refused
def test_the_cards_of_a_contact_are_its_law(kind, dialect):
    assert worst_cards(kind, dialect) < 1e-8


@pytest.mark.parametrize("kind", NORMALS)
def test_the_law_of_a_contact_follows_its_declaration(kind):
    normal = NORMALS[kind]
    stated_ = pressing(normal)
    values = stated_.compute_parameter_values(stated_.keys())
    own = law.DeclaredLaw("law", stated_, tuple(values.values()))
    for x, rate, slide, wanted in touching(normal):
        known = {"p": x[0] + GAPS[0], "q": x[1] + GAPS[1], "slide": 0.0}
        speeds = {"p": rate[0], "q": rate[1], "slide": slide}
        e = np.array(
            [(speeds if across.rate else known)[across.pin] for across in own.across_inputs]
        )
        mode = own.find_initial_mode(e)
        out, by = own.evaluate(e, mode)
        np.testing.assert_allclose(out, wanted, rtol=1e-12, atol=1e-12)
        flows = own._flow_function
        exact = [np.imag(flows(*(e + 1j * H * unit), *mode, *own.values)[: len(out)]) / H
                 for unit in np.eye(e.size)]  # fmt: skip
        np.testing.assert_allclose(by, np.array(exact).T, rtol=1e-12, atol=1e-12)
        moving = np.array(
            [0.0 if across.rate else speeds[across.pin] for across in own.across_inputs]
        )
        rise = np.imag(own._energy_function(*(e + 1j * H * moving), *mode, *own.values)[0]) / H
        brought = sum(f * speeds[flow.pin] for f, flow in zip(out, own.flows, strict=True))
        lost = own.loss(e, mode)
        assert abs(brought - rise - lost) <= 1e-12 * (abs(brought) + abs(rise) + abs(lost))
        assert normal.pace or lost >= -1e-12 * abs(brought)


# --- that all this can fail ----------------------------------------------------------------------


WRONG = [("cubic_spring", "ngspice", "1e-6*V", "1.00001e-6*V"),
         ("cubic_spring", "verilog-a", "I(a,b) <+", "I(b,a) <+"),
         ("comb_drive", "xyce", "sense_v 1e-06", "sense_v 1.00001e-06"),
         ("voice_coil", "ngspice", "{resistance*I", "{1.0001*resistance*I")]  # fmt: skip


@pytest.mark.parametrize(("name", "dialect", "before", "after"), WRONG)
def test_a_wrong_card_is_detected(name, dialect, before, after):
    text = printed(name, dialect)
    assert before in text
    assert worst_printed(name, text.replace(before, after)) > 1e-6


def test_a_wrong_law_is_detected():
    """Of a coil with another motor, whose powers are even."""
    assert worst_law("voice_coil", bl=6.0001)[0] > 1e-6


def test_energy_created_by_a_part_is_detected(monkeypatch):
    good = law.DeclaredLaw.loss
    monkeypatch.setattr(law.DeclaredLaw, "loss", lambda self, e, mode: 1.001 * good(self, e, mode))
    assert worst_law("voice_coil")[1] > 1e-6
