"""The glossary defines every term of the program that the documentation uses."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"
# Words with a meaning of their own in this program, as patterns for their forms in a text. A word
# of this list that a page uses needs a line in the glossary.
TERMS = {
    "certificate": "certificates?",
    "clamped capacitance": "clamped capacitance",
    "coupling factor": "(effective )?coupling factors?",
    "deck": "decks?",
    "declaration": "declarations?",
    "descriptor model": "descriptor models?",
    "dialect": "dialects?",
    "error bound": "error bounds?",
    "error budget": "error budgets?",
    "error estimate": "error estimates?",
    "expansion point": "expansion points?",
    "frame": "frames?",
    "free stroke": "free strokes?",
    "full model": "full models?",
    "gallery": "gallery",
    "gate": "gates?",
    "groove": "grooves?",
    "indentation": "indentations?",
    "intermediate model": "intermediate models?",
    "lookup": "lookups?",
    "massless mode": "massless modes?",
    "metric": "metrics?",
    "mutant": "mutants?",
    "neglected effect": "neglected effects?",
    "notch": "notch(es)?",
    "numerical setting": "numerical settings?",
    "operating point": "operating points?",
    "part type": "part types?",
    "passive": "passive|passivity",
    "patch": "patch(es)?",
    "probe": "probes?",
    "rating": "ratings?",
    "reduced model": "reduced models?",
    "reductor": "reductors?",
    "resonator": "resonators?",
    "rigid-body mode": "rigid-body modes?",
    "ring": "rings?",
    "ringing": "ringing",
    "scene": "scenes?",
    "scene hash": "scene hash",
    "sidecar": "sidecars?",
    "signal pin": "signal pins?",
    "snapshot": "snapshots?",
    "subcircuit": "subcircuits?",
    "sweep": "sweeps?",
    "band": "bands?",
}


def glossary():
    rows = re.findall(r"(?m)^\| ([^|]+) \| ([^|]+) \|$", GLOSSARY.read_text(encoding="utf-8"))
    return {term.strip(): meaning.strip() for term, meaning in rows[1:]}


def prose(path):
    """Text of a page without blocks of code, code words and addresses of links."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return re.sub(r"`[^`\n]*`|\]\([^)]*\)", " ", text)


def bold_terms(text):
    """Words in bold inside a sentence; those at the start of an item are its heading."""
    return {term.lower() for term in re.findall(r"(?<=[a-z,] )\*\*([a-z][a-z -]+)\*\*", text)}


@pytest.fixture(scope="module")
def pages():
    paths = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    return {path: prose(path) for path in paths if path != GLOSSARY}


def test_every_term_in_use_is_defined(pages):
    defined = set(glossary())
    used = {}
    for term, pattern in TERMS.items():
        form = re.compile(rf"\b({pattern})\b", re.IGNORECASE)
        for path, text in pages.items():
            if form.search(text):
                used.setdefault(term, path)
    assert not {term: str(path) for term, path in used.items() if term not in defined}


def test_every_word_in_bold_inside_a_sentence_is_defined(pages):
    plain = {"no"}
    defined = set(glossary()) | plain
    assert not set().union(*map(bold_terms, pages.values())) - defined


def test_the_search_finds_terms():
    assert bold_terms("Reduction attaches a **certificate** to it.\n**Checks.** Text.") == {
        "certificate"
    }


def test_every_definition_is_one_sentence():
    terms = glossary()
    for term, meaning in terms.items():
        assert meaning.endswith("."), term
        assert not re.search(r"\.\s+[A-Z]", meaning), term
    assert len(terms) > 60
