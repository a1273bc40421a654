"""Comments of netlists of declared parts name the quantities of the part's physical domain."""

import re
from itertools import chain

import pytest
from support import Declaration, branch, write_subcircuit_items

import kc2spice as kc

# Time integral of each quantity with its SI unit, as in textbooks.
INTEGRALS = {
    "voltage": ("charge", "coulombs"),
    "current": ("flux", "webers"),
    "temperature": ("stored heat", "joules"),
    "pressure": ("volume", "m3"),
    "volume_velocity": ("pressure impulse", "Pa s"),
}
ELECTRICAL = re.compile(r"\b(charge|coulombs|flux|webers|voltage|current from)\b")


class Keys(kc.Section):
    """Storage."""

    c: float = 1.0


def comments(kind: str) -> str:
    storage = branch(kind)
    stored = Declaration("store", "store", Keys, (storage,), coenergy=f"0.5*c*{storage.name}^2")
    notes = chain.from_iterable(item.notes for item in write_subcircuit_items(stored))
    return re.sub(r"\s*\n\*\s+", " ", "\n".join(notes))


@pytest.mark.parametrize("kind", INTEGRALS)
def test_a_storage_names_its_integral_and_unit(kind):
    integral, unit = INTEGRALS[kind]
    assert f"{integral} = c*" in comments(kind)
    assert re.search(rf"1 V = scale_\w+ {unit}; its", comments(kind))


@pytest.mark.parametrize("kind", ["temperature", "pressure", "volume_velocity"])
def test_heat_and_sound_have_no_words_of_circuits(kind):
    assert not ELECTRICAL.search(comments(kind))
