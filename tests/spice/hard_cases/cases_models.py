"""Models of other tools and circuits of users; oracles: full matrices in numpy, closed forms."""

import mor_families as families
import numpy as np
from device import chip, deck_of
from hard_cases.kit import HEADER, LATCH, bench_deck, case
from support import LinearModel, load_scene, make_opamp_subcircuit, reduce_model, subcircuit

RESPONSE = "largest error of the response, relative to its peak"
SIZE = 40


def response_error(bench, matrices, top=0.1):
    """Reduced, written, run in ngspice, against ``C (s^2 M + s E + K)^-1 B`` in full."""
    model = LinearModel(**families.as_files(matrices), name="hard")
    rom = reduce_model(model, band=(0.0, top), tolerance=1e-6)
    part, frequency = subcircuit(rom, "part", HEADER), np.linspace(top / 50, top, 50)
    size = rom.B.shape[1], rom.C.shape[0]
    found = families.spice_response(part, *size, frequency, bench.directory)
    expected = families.full_response(matrices, frequency)
    return float((np.abs(found - expected) / np.abs(expected).max(axis=0)).max())


@case("nearly parallel Krylov vectors", RESPONSE, 1e-5)
def input_vectors_that_differ_by_1e_12(bench):
    ports = families.chain()["B"][:, [0, 0, 1]]
    ports[3, 1] = 1e-12
    return response_error(bench, families.chain() | {"B": ports})


@case("model without supports", RESPONSE, 1e-5)
def chain_with_a_rigid_body_mode(bench):
    free = families.chain()["K"]
    free[0, 0] = free[-1, -1] = 1.0
    return response_error(bench, families.chain() | {"K": free, "E": 0.02 * free})


@case("singular stiffness matrix", RESPONSE, 1e-5)
def masses_on_dashpots_only(bench):
    """Ten of forty masses hang in the air by dashpots: K has rank 30."""
    loose = families.chain()["K"]
    loose[30:, :] = loose[:, 30:] = 0.0
    drag = families.chain()["E"] + np.diag(np.r_[np.zeros(30), np.ones(10)])
    drag[29, 30] = drag[30, 29] = 0.0
    return response_error(bench, families.chain() | {"K": loose, "E": drag})


@case("indefinite stiffness matrix", RESPONSE, 1e-5)
def chain_with_a_negative_stiffness(bench):
    """Unstable, and the certificate says so; its response is right all the same."""
    bent = families.chain()["K"] - np.diag(np.r_[0.0, 5.0, np.zeros(SIZE - 2)])
    return response_error(bench, families.chain() | {"K": bent})


@case("unsymmetric stiffness matrix", RESPONSE, 1e-5)
def chain_with_unsymmetric_stiffness(bench):
    return response_error(
        bench, families.chain() | {"K": families.chain()["K"] + 0.01 * np.eye(SIZE, k=1)}
    )


SIZES = {
    "chain of masses of 1e-21 kg": (1e-21, 1e3),
    "chain of masses of 1e9 kg": (1e9, 1e-3),
}  # kg, N/m
for name, size in SIZES.items():

    @case("very small and very large values", RESPONSE, 1e-5, name=name)
    def scaled(bench, size=size):
        rate, given = np.sqrt(size[1] / size[0]), families.chain()
        scale = {"M": size[0], "E": size[1] / rate, "K": size[1], "B": 1.0}
        return response_error(bench, {k: v * given[k] for k, v in scale.items()}, 0.1 * rate)


@case("op-amp output at the supply voltage", "output voltage, relative", 1e-3)
def amplifier_of_gain_11_in_saturation(bench):
    """Gain 11 on 5 V between rails of 15 V, then back: the output leaves the rail without delay."""
    cards = """Vin in 0 PWL(0 5 1e-5 5 1.1e-5 1)
Vcc vcc 0 15
Vee vee 0 -15
Xop in n out vcc vee 0 opamp gbw=1e7
R1 n 0 1000
R2 out n 10000
.options reltol=1e-4 trtol=1
.tran 1e-8 3e-5 0 1e-7"""
    part = make_opamp_subcircuit(HEADER)
    waves = bench.run(bench_deck([part], cards, {"out": ("v(out)", 1.0)}, 3e-5))
    rail = np.interp(0.9e-5, waves["time"], waves["out"])
    # gbw / 11: the linear answer 11 V is reached to 1e-6 within 2.5 us
    back = np.interp(1.6e-5, waves["time"], waves["out"])
    return max(abs(rail / 15 - 1), abs(back / 11 - 1))


@case(
    "circuit without a solution",
    "reason in the error message",
    refused="(?i)failed|iteration|timestep",
)
def latch_without_an_operating_point(bench):
    """A latch of exponentials that contradicts itself: no solution exists."""
    (bench.directory / "mine.lib").write_text(LATCH)
    path = bench.directory / "mine.toml"
    path.write_text(
        'name = "mine"\ninclude = ["mine.lib"]\n[kick.driver.user]\nsubckt = "mine"\n'
        '[kick.drive]\nstart = 1e-5\n[contact]\nrings = "all"\n[sphere]\n[solver]\nstop = 4e-5\n'
    )
    bench.run(deck_of(load_scene(path), chip(6)))
    return 0.0
