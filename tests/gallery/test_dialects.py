"""Every scene of the gallery is exported in every dialect."""

import re

import pytest
from support import (
    list_deck_dialects,
    list_dialect_names,
    list_gallery,
    translate_deck,
    write_dialect_files,
)

import kc2spice as kc

QUICK = (
    "buzzer_square",
    "em_force",
    "harvester",
    "impact",
    "newtons_cradle",
    "pwm_coil",
    "thermostat",
)
# Scenes with a model that no other simulator has: a VDMOS with thermal pins.
NGSPICE_ALONE = ("mosfet_sink",)


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in sorted(list_gallery())
    ],
)
def test_every_scene_has_every_dialect(scene):
    deck = kc.deck(scene)
    alone = scene in NGSPICE_ALONE
    if deck.command.kind == "noise" or alone:
        for dialect in (list_deck_dialects() if alone else list_dialect_names())[1:]:
            with pytest.raises(kc.errors.UsageError, match=r"no equivalent|noise"):
                write_dialect_files(deck, dialect)
        return
    for dialect in list_dialect_names()[1:]:
        assert write_dialect_files(deck, dialect)
    for dialect in list_deck_dialects()[1:]:
        spoken = translate_deck(deck, dialect).vectors
        assert spoken.keys() == deck.vectors.keys()
        for name, (expression, factor) in spoken.items():
            own, scale = deck.vectors[name]
            assert factor == scale
            assert re.fullmatch(r"-?[VI]\([\w:]+\)([-+][VI]\([\w:]+\))*", expression), expression
            assert re.findall(r"[-+](?=[VI]\()", expression) == re.findall(r"[-+](?=[vi@])", own)
