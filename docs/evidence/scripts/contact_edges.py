"""Drop a sphere a hundred times onto a rigid plane; count landings and the energy that is left.

The force over depth is a plain function of ngspice, or the subcircuit contact.lib of kc2spice,
which makes ngspice place time points where a contact begins and ends.
"""

import numpy as np
from tables import power, print_table

import kc2spice as kc
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.subcircuit_library import Header
from kc2spice.parts.mechanics.sphere import SphereKeys, declare_sphere
from kc2spice.physics.contact import ContactForce, declare_contact
from kc2spice.physics.part import make_declared_subcircuit

MASS, STIFFNESS, GRAVITY = SphereKeys().mass, 4e8, 9.81  # kg, N/m, m/s2
SPEED, HEIGHT, LANDINGS = 0.01, 1e-7, 100  # m/s downwards, m
STOP = (LANDINGS + 0.5) * (2 * SPEED / GRAVITY + np.pi * np.sqrt(MASS / STIFFNESS))
HEADER = Header("bounces", "0")
SPHERE = make_declared_subcircuit(
    HEADER, "sphere", declare_sphere(MASS, 1e-3, GRAVITY, -SPEED, HEIGHT), {}
)
LAW = declare_contact(("ring0",), (0.0,), ContactForce(STIFFNESS))
CONTACT = make_declared_subcircuit(HEADER, "contact", LAW, {})
LAWS = {
    "max(0, depth)": f"Bcontact 0 v I={1e-6 * STIFFNESS}*max(0, -V(bottom))",
    "contact.lib": "Vplane ring0 0 0\nXcontact ring0 v bottom 0 contact",
}
OPTIONS = {
    "trap, reltol 1e-4": "reltol=1e-4 trtol=1 chgtol=1e-8",
    "trap, reltol 1e-6": "reltol=1e-6 trtol=1 chgtol=1e-12",
    "gear, reltol 1e-6": "reltol=1e-6 trtol=1 chgtol=1e-12 method=gear",
    "ngspice's default": "",
}


def bounces(law: str, options: str) -> tuple[float, int, int]:
    """Relative change of the energy, number of landings, number of time points."""
    cards = f".options {options}" if options else ""
    text = f"""* bounces
.include {SPHERE.filename}
.include {CONTACT.filename}
Xsphere v bottom y 0 sphere
{law}
{cards}
.tran 1e-4 {STOP} 0 1e-5 uic
.save v(v) v(bottom)
.end
"""
    more = {part.filename: part.text for part in (SPHERE, CONTACT)}
    vectors = {"v": ("v(v)", 1.0), "bottom": ("v(bottom)", 1.0)}
    deck = Deck(name="bounces", text=text, more=more, vectors=vectors, stop=STOP)
    waves = kc.simulate(deck).waves
    speed, height = waves["v"], 1e-6 * waves["bottom"]
    energy = (speed**2 / 2 + GRAVITY * height)[height > HEIGHT / 10]
    landings = np.count_nonzero((height[:-1] > 0) & (height[1:] <= 0))
    return energy[-1] / (SPEED**2 / 2 + GRAVITY * HEIGHT) - 1, int(landings), len(speed)


if __name__ == "__main__":
    print_table(
        ["force over depth", "solver", "energy gained", "landings of 100", "time points [1000]"],
        (
            [law, option, power(gain), landings, f"{points / 1e3:.0f}"]
            for law in LAWS
            for option in OPTIONS
            for gain, landings, points in [bounces(LAWS[law], OPTIONS[option])]
        ),
    )
