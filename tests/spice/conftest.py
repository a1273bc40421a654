"""Fixtures of the ngspice tests: the made-up device and the loop around it."""

import device
import pytest
from support import (
    ContactForce,
    Header,
    PidKeys,
    SphereKeys,
    compute_ring_gaps,
    declare_contact,
    declare_sphere,
    load_scene,
    make_coils_subcircuit,
    make_opamp_subcircuit,
    make_pid_subcircuit,
    run_deck,
    subcircuit,
)
from support import make_declared_subcircuit as declared

LOOP = {
    "name": "loop", "kick": {"drive": {"voltage": 80.0}}, "contact": {"rings": "all"},
    "sphere": {}, "catch": {}, "control": {},
}  # fmt: skip


@pytest.fixture(scope="session")
def radii():
    return device.RADII


@pytest.fixture(scope="session")
def table():
    return device.magnets()


@pytest.fixture(scope="session")
def header():
    return Header("test", "0")


@pytest.fixture(scope="session")
def parts(header, model, radii, table):
    """The subcircuits of kick and catch, by name."""
    ball = SphereKeys()
    rings = tuple(f"ring{i}" for i in range(6))
    gaps = tuple(compute_ring_gaps(radii, ball.radius).tolist())
    made = (
        subcircuit(model.to_linear_model(), "kick", header),
        declared(header, "sphere", declare_sphere(ball.mass, ball.radius, 9.81), {}),
        declared(header, "contact", declare_contact(rings, gaps, ContactForce(4e8)), {}),
        make_coils_subcircuit(header, table, "catch", apart=False, points=81),
        make_coils_subcircuit(header, table, points=81),
        make_opamp_subcircuit(header),
        make_pid_subcircuit(header, PidKeys()),
    )
    return {part.name: part for part in made}


@pytest.fixture(scope="session")
def scene():
    """The loop at a voltage that launches the made-up device at about 1 m/s."""
    return load_scene(LOOP)


@pytest.fixture(scope="session")
def loop(scene, model, table):
    """Deck of the loop."""
    return device.deck_of(scene, model, table)


@pytest.fixture(scope="session")
def waves(loop, tmp_path_factory):
    """Waves of ngspice for the loop."""
    return run_deck(loop, tmp_path_factory.mktemp("loop"))


@pytest.fixture(scope="session")
def varied():
    """The same loop with other keys, or ``None`` for a part that is left out."""

    def vary(tables=None, **keys):
        data = {**LOOP, **(tables or {})}
        return load_scene({k: v for k, v in data.items() if v is not None}, keys)

    return vary
