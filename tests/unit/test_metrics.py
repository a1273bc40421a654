"""Metrics against waveforms whose numbers are known in closed form."""

import json

import numpy as np
import pytest
from support import (
    BuiltScene,
    Metrics,
    Waveforms,
    add_results_and_sources,
    compute_metrics,
    compute_settling_time,
    find_separation,
    load_scene,
)

RADIUS, LAUNCH, SPEED, DECEL = 1e-3, 5.0057e-4, 1.02, 40.0


def uneven(stop: float, n: int = 4001) -> np.ndarray:
    """Time points whose spacing varies by a factor of about 20."""
    s = np.linspace(0.0, 1.0, n)
    return stop * (s + 0.9 * np.sin(2 * np.pi * 5 * s) / (2 * np.pi * 5))


def throw(t: np.ndarray) -> Waveforms:
    """At rest until LAUNCH, then ballistic; the load decays linearly to zero at LAUNCH."""
    s = np.maximum(0.0, t - LAUNCH)
    force = 3.0 * np.clip((LAUNCH - t) / 1e-6, 0.0, 1.0)
    y = RADIUS + SPEED * s - 0.5 * DECEL * s**2
    v = np.where(t > LAUNCH, SPEED - DECEL * s, 0.0)
    stroke = 4.2e-6 * np.exp(-(((t - 5.02e-4) / 2e-6) ** 2))
    data = {"time": t, "sphere.y": y, "sphere.v": v, "contact.force": force, "kick.u.ring0": stroke}
    return Waveforms(data, {})


def edge(waves: Waveforms) -> tuple[float, float] | None:
    """End of the contact: time and velocity."""
    return find_separation(waves["time"], waves["contact.force"], waves["sphere.v"])


def build_scene(name: str) -> BuiltScene:
    """Return a gallery scene with the list of its results, without models."""
    return add_results_and_sources(BuiltScene(load_scene(name), {}))


def find_metrics(waves: Waveforms, name: str) -> Metrics:
    """Metrics of the parts of a gallery scene, without their models."""
    return compute_metrics(waves, build_scene(name))


def of_scene(waves: Waveforms, name: str) -> dict[str, object]:
    """Values of the metrics."""
    return find_metrics(waves, name).values


def kick_times() -> np.ndarray:
    """Coarse flight, 50 ns around the kick, never a sample on the launch itself."""
    fine = np.arange(4.95e-4, 5.3e-4, 50e-9) + 13e-9
    return np.union1d(np.linspace(0.0, 5e-3, 900), fine)


def test_launch_is_found_within_a_sample_gap() -> None:
    found = edge(throw(kick_times()))
    assert found is not None
    # The load is linear up to the edge, so the extrapolation is exact but for rounding.
    assert found[0] == pytest.approx(LAUNCH, abs=1e-15)
    assert found[1] == pytest.approx(SPEED, rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_settling_of_an_exponential(sign: float) -> None:
    t = uneven(5e-3)
    tau = 0.4e-3
    y = 2.5e-3 + sign * 1.5e-3 * np.exp(-t / tau)
    exact = tau * np.log(20.0)
    # Linear interpolation within steps of up to 5 us: h^2 / (8 tau) = 8 ns.
    assert compute_settling_time(t, y, 2.5e-3, 75e-6) == pytest.approx(exact, abs=1e-8)


def test_settling_counts_the_last_entry_and_refuses_an_exit() -> None:
    t = np.linspace(0.0, 10.0, 1001)
    ringing = np.exp(-0.3 * t) * np.cos(2 * np.pi * t)
    found = compute_settling_time(t, ringing, 0.0, 0.5)
    assert abs(np.exp(-0.3 * found) * np.cos(2 * np.pi * found)) == pytest.approx(0.5, abs=2e-3)
    assert np.all(np.abs(ringing[t > found]) <= 0.5)
    assert compute_settling_time(t, t, 0.0, 5.0) is None
    assert compute_settling_time(t, 0 * t, 0.0, 5.0) == 0.0


def test_loop_metrics_of_a_caught_and_a_lost_sphere() -> None:
    t = kick_times()
    waves = throw(t)
    s = np.maximum(0.0, t - LAUNCH)
    caught = 2.5e-3 - 1.5e-3 * np.exp(-s / 0.4e-3)
    coil = {"coil.upper.current": 0 * t + 4.9e-4}
    got = of_scene(Waveforms(waves.data | coil | {"sphere.y": caught}, {}), "kick_and_catch")
    assert got["caught"] is True
    assert got["settling_time_s"] == pytest.approx(LAUNCH + 0.4e-3 * np.log(20.0), abs=1e-8)
    assert got["final_error_m"] == pytest.approx(1.5e-3 * np.exp(-s[-1] / 0.4e-3), rel=1e-9)
    assert got["kick_stroke_m"] == pytest.approx(4.2e-6, rel=1e-3)
    assert got["hold_current_a"] == pytest.approx(4.9e-4, rel=1e-12)
    json.dumps(got)
    lost = of_scene(Waveforms(waves.data | coil, {}), "kick_and_catch")
    assert lost["caught"] is False
    assert lost["settling_time_s"] is None
    assert lost["peak_height_m"] == pytest.approx(waves["sphere.y"].max())


def test_a_rising_sphere_is_a_warning_unless_a_controller_has_caught_it() -> None:
    t = kick_times()
    waves = throw(t)
    voltage = {"kick.voltage": 0 * t}
    caught = 2.5e-3 - 1.5e-3 * np.exp(-np.maximum(0.0, t - LAUNCH) / 0.4e-3)
    held = find_metrics(Waveforms(waves.data | {"sphere.y": caught}, {}), "kick_and_catch")
    assert held.values["still_rising"] is True
    assert held.warnings == {}
    for scene in ("kick_and_catch", "half_bridge_kick"):
        lost = find_metrics(Waveforms(waves.data | voltage, {}), scene)
        assert lost.values["still_rising"] is True
        assert lost.warnings["still_rising"].startswith("sphere is still rising at the end")
    fallen = find_metrics(Waveforms(throw(30.0 * t).data | voltage, {}), "half_bridge_kick")
    assert "still_rising" not in fallen.values
    assert fallen.warnings == {}
    weightless = Waveforms({"time": t, "sphere5.y": waves["sphere.y"], "sphere5.v": 1.0 + t}, {})
    found = compute_metrics(weightless, build_scene("newtons_cradle"), partial=True)
    assert found.values["still_rising"] is True
    assert found.warnings == {}


def test_impact_on_a_spring() -> None:
    """Half a period of a mass on a spring: depth v / w, contact pi / w, rebound speed v."""
    scene = load_scene("impact", [])
    w, speed, gap = np.pi / 9e-6, 1.0, 1e-6
    t = uneven(15e-6, 701)
    hit = t - gap / speed
    touching = (hit > 0) & (hit < np.pi / w)
    y = np.where(hit < 0, gap - speed * t, speed * (hit - np.pi / w))
    y = RADIUS + np.where(touching, -speed / w * np.sin(w * hit), y)
    v = np.where(touching, -speed * np.cos(w * hit), np.where(hit < 0, -speed, speed))
    k = scene.parts["sphere"].keys.mass * w**2
    force = np.where(touching, k * speed / w * np.sin(w * hit), 0.0)
    data = {"time": t, "sphere.y": y, "sphere.v": v, "contact.force": force}
    got = of_scene(Waveforms(data, {}), "impact")
    # Samples are up to 40 ns apart: the parabola misses (w h)^4 / 400, the linear edge
    # less.
    assert got["min_position_m"] == pytest.approx(-speed / w, rel=1e-6)
    assert got["time_of_min_s"] == pytest.approx(1e-6 + 4.5e-6, abs=1e-10)
    assert got["separation_time_s"] == pytest.approx(10e-6, abs=1e-10)
    assert got["rebound_velocity_m_s"] == pytest.approx(speed, rel=1e-9)
    assert got["max_force_n"] == pytest.approx(k * speed / w / 4, rel=1e-4)


def test_imprint_and_harmonic_give_lists_of_one_sector() -> None:
    depth, force = np.linspace(0, 5e-5, 5), np.linspace(0, 800.0, 5)
    waves = Waveforms({"imprint.depth": depth, "contact.force": force}, {})
    got = of_scene(waves, "imprint")
    assert got["force_n"][-1] == 200.0
    assert got["imprint_m"] == depth.tolist()
    sweep = {"frequency": np.array([1.0, 2.0]), "ring0>anode": np.array([3 + 4j, 0j])}
    got = of_scene(Waveforms(sweep, {}), "harmonic")
    assert got["amplitude"]["ring0"]["anode"] == [5.0, 0.0]
    json.dumps(got)
