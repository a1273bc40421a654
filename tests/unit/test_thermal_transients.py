"""Heat networks of thermal transients: random networks, a measured LED, and refused files."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from support import (
    FosterNetwork,
    StepSamples,
    fit_transient,
    is_transient,
    read_rom,
    read_title,
    read_transient,
    reduce_file,
)

import kc2spice as kc

DATA = Path(__file__).parents[1] / "data" / "transients"
LED = DATA / "T25_I-m5m-I-h600m_100s.raw"
LED_POWER = 1.754057  # W, in the file .pwr
DEAD_TIME = 2e-4  # s, after which the electrical transient of the LED is over


def led_cooling():
    """Times [s] and temperatures [degC] of the LED, by the calibration beside its record."""
    lines = LED.read_text().splitlines()
    head = [line.lstrip("# ") for line in lines if line.startswith("#")]
    volts_per_digit, volts_per_kelvin, middle = float(head[6]), -float(head[7]), float(head[8])
    table = np.array([line.split() for line in lines if not line.startswith("#")], float)
    volts = middle + (table[:, 1] - 2048) * volts_per_digit
    time = 1e-6 * table[:, 0]
    known = time > DEAD_TIME
    return time[known], (volts[known] - 2.6505) / volts_per_kelvin


def transient_file(path, time, value, head="time_s,temperature_k"):
    rows = zip(time, value, strict=True)
    path.write_text(head + "\n" + "".join(f"{t:.9g},{y:.9g}\n" for t, y in rows))
    return path


def compute_step_response(resistance, constants, time):
    """Sum of exponentials, written apart from the code under test."""
    total = np.zeros(len(time))
    for R, t in zip(resistance, constants, strict=True):
        total += R * (1 - np.exp(-np.maximum(time, 0.0) / t))
    return total


def random_modes(rng):
    count = int(rng.integers(1, 6))
    return 10 ** rng.uniform(-1, 1, count), 10 ** rng.uniform(-4, 0.5, count)


@pytest.mark.parametrize("seed", range(40))
def test_random_networks_are_recovered_from_noise(seed):
    rng = np.random.default_rng([48, seed])
    resistance, constants = random_modes(rng)
    time = np.geomspace(1e-5, 20.0, 400)
    exact = compute_step_response(resistance, constants, time)
    noise = 10 ** rng.uniform(-4, -2) * exact[-1]
    value = 25.0 + exact + noise * rng.standard_normal(400)
    fit = fit_transient(StepSamples(time, value, np.ones(400), offset=True))
    assert (fit.network.resistance > 0).all()
    assert (fit.network.time_constant > 0).all()
    assert fit.noise == pytest.approx(noise, rel=0.15)
    assert fit.rms_residual < 1.15 * noise
    # 2 n + 1 parameters spread the noise over the response: rms noise sqrt((2 n + 1) / samples)
    error = fit.start + compute_step_response(
        fit.network.resistance, fit.network.time_constant, time
    )
    error -= 25.0 + exact
    count = 2 * len(fit.network.resistance) + 1
    assert np.sqrt(np.mean(error**2)) < 2.5 * noise * np.sqrt(count / 400)
    assert len(fit.network.resistance) <= len(resistance) + 1


def test_the_cooling_of_an_led_is_within_its_noise_at_samples_that_the_fit_does_not_know():
    time, temperature = led_cooling()
    value = -temperature / LED_POWER
    one = np.ones(len(time[::2]))
    fit = fit_transient(StepSamples(time[::2], value[::2], one, offset=True))
    network = fit.network
    assert (network.resistance > 0).all()
    assert (network.time_constant > 0).all()
    others = fit.start + compute_step_response(
        network.resistance, network.time_constant, time[1::2]
    )
    deviation = others - value[1::2]
    # one digit of the converter is 0.0092 K/W; the noise from differences is as large
    assert fit.noise == pytest.approx(0.0093, rel=0.1)
    assert np.sqrt(np.mean(deviation**2)) < 1.1 * fit.noise
    assert np.abs(deviation).max() < 5 * fit.noise
    # slow deviations: means over 40 samples have a noise smaller by sqrt(40)
    means = deviation[: len(deviation) // 40 * 40].reshape(-1, 40).mean(axis=1)
    assert np.sqrt(np.mean(means**2)) < 0.5 * fit.noise


@pytest.mark.parametrize("form", ["foster", "cauer"])
def test_the_netlist_of_the_led_follows_its_record_in_ngspice(tmp_path, form):
    time, temperature = led_cooling()
    path = transient_file(tmp_path / "led.csv", time, temperature)
    found = reduce_file(path, tmp_path / "out", power="1.754057 W", network=form)
    assert found["passive"]
    assert found["stable"]
    part = kc.subcircuit(read_rom(found["rom"]), "led")
    (tmp_path / "led.lib").write_text(part.text)
    (tmp_path / "step.cir").write_text(
        "step of the power\n.include led.lib\nXled junction 0 led\n"
        "Iloss 0 junction PULSE(0 1.754057 0 1n 1n 1k)\n.options reltol=1e-5\n"
        ".tran 1m 100 0 50m uic\n.control\nrun\nset wr_vecnames\nset wr_singlescale\n"
        "wrdata step.txt v(junction)\nquit 0\n.endc\n.end\n"
    )
    run_ngspice(tmp_path, "step.cir")
    table = np.loadtxt(tmp_path / "step.txt", skiprows=1)
    simulated = np.interp(time, table[:, 0], table[:, 1])
    fall = temperature.max() - temperature
    offset = np.mean(fall - simulated)  # the temperature before the step is not measured
    deviation = fall - simulated - offset
    noise = found["noise"] * simulated[-1]
    assert np.sqrt(np.mean(deviation**2)) < 1.2 * noise


def run_ngspice(folder, deck):
    done = subprocess.run(
        ["ngspice", "-b", "-n", deck], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


ZTH = FosterNetwork(np.array([0.05, 0.4, 1.5]), np.array([1e-4, 5e-3, 0.8]))


@pytest.mark.parametrize(
    ("head", "factors"),
    [
        ("time_s,zth_k_per_w", (1.0, 1.0)),
        ("t (ms),Zth(j-c) (K/W)", (1e3, 1.0)),
        ("Pulse width [us],Zth [mK/W]", (1e6, 1e3)),
        ("tp/s,Zth/K/W", (1.0, 1.0)),
    ],
)
def test_a_table_of_the_thermal_impedance_is_described_to_each_value(tmp_path, head, factors):
    time = np.geomspace(1e-5, 10.0, 49)
    columns = factors[0] * time, factors[1] * ZTH.compute_step_response(time)
    path = transient_file(tmp_path / "sheet.csv", *columns, head)
    found = reduce_file(path, tmp_path / "out")
    assert found["quantity"] == "zth"
    assert found["norm"] == "pointwise"
    assert found["error_estimate"] < 1e-3
    model = read_rom(found["rom"])
    assert model.transfer([0.0])[0, 0, 0].real == pytest.approx(ZTH.total_resistance, rel=1e-3)


@pytest.mark.parametrize(
    ("head", "time", "value"),
    [
        ("Time [ms],Temperature (°C)", 1e3, lambda rise: 23.0 + rise),
        ("time_s,temperature_k", 1.0, lambda rise: 300.0 + rise),
        ("Elapsed time (min),Tj (°F)", 1 / 60, lambda rise: 70.0 + 1.8 * rise),
        ("t (s),T (K)", 1.0, lambda rise: 400.0 - rise),  # cooling
        ("Time\tRise\ns\tmK", 1.0, lambda rise: 1e3 * rise),
    ],
)
def test_every_layout_of_a_temperature_is_the_same_network(tmp_path, head, time, value):
    seconds = np.r_[-0.2, -0.1, np.geomspace(1e-5, 10.0, 99)]
    rise = 2.0 * ZTH.compute_step_response(seconds)
    path = transient_file(tmp_path / "step.csv", time * seconds, value(rise), head)
    if "\t" in head:
        path.write_text(path.read_text().replace(",", "\t"))
    assert is_transient(path)
    found = reduce_file(path, tmp_path / "out", power=2.0)
    f = np.geomspace(0.02, 1e3, 20)
    s = 2j * np.pi * f[:, None]
    exact = (ZTH.resistance / (1 + s * ZTH.time_constant)).sum(axis=1)
    deviation = read_rom(found["rom"]).transfer(f)[:, 0, 0] - exact
    assert np.abs(deviation).max() < 1e-3 * ZTH.total_resistance


def test_a_response_that_has_not_settled_warns(tmp_path):
    time = np.linspace(0.0, 0.3, 200)
    path = transient_file(tmp_path / "short.csv", time, 300 + ZTH.compute_step_response(time))
    found = reduce_file(path, tmp_path / "out", power=1.0)
    assert any("extrapolated" in text for text in found["warnings"])


TIME = np.linspace(0.0, 5.0, 60)
RISE = 300 + 2 * ZTH.compute_step_response(TIME)


@pytest.mark.parametrize(
    ("head", "time", "value", "options", "words"),
    [
        ("time_s,temperature_k", TIME, RISE, {}, "the power is missing"),
        ("time_s,temperature_k", TIME, RISE, {"power": "-2 W"}, "not a positive power"),
        ("time_s,temperature_k", TIME, RISE, {"power": "2 V"}, "--power"),
        (
            "time_s,temperature_k",
            TIME,
            RISE,
            {"power": 2, "dc": "open"},
            "only to a measured impedance",
        ),
        (
            "time_s,temperature_k",
            TIME,
            RISE,
            {"power": 2, "order": 3},
            "does not apply to a measured response",
        ),
        ("time_s,temperature_k", TIME, RISE, {"power": 2, "network": "x"}, "this form of"),
        ("time_s,temperature_k", TIME - 10, RISE, {"power": 2}, "0 time points after zero"),
        ("time_s,temperature_k", TIME, 0 * RISE + 300, {"power": 2}, "does not change"),
        ("time_s,speed_k", TIME, RISE, {"power": 2}, "neither a temperature nor a thermal"),
        ("time_s,zth_k_w", TIME, RISE, {"power": 2}, "with a thermal impedance"),
        ("time_s,zth_k_w", TIME, -RISE, {"power": None}, "falls"),
    ],
)
def test_refused_transients_state_the_problem(tmp_path, head, time, value, options, words):
    path = transient_file(tmp_path / "bad.csv", time, value, head)
    with pytest.raises(kc.errors.UsageError) as caught:
        reduce_file(path, tmp_path / "out", **options)
    assert words in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_an_oscillation_is_no_heat_network(tmp_path):
    wave = 300 + TIME + 2 * np.sin(3 * TIME)
    path = transient_file(tmp_path / "wave.csv", TIME, wave)
    with pytest.raises(kc.errors.GateMissedError, match="no thermal network"):
        reduce_file(path, tmp_path / "out", power=1.0)
    assert not (tmp_path / "out").exists()


def test_a_directory_that_cannot_be_written_is_noticed_before_the_fit(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "kc2spice.workflow.reduction_of_models_from_files.fit_transient_network",
        lambda *_: pytest.fail("fitted"),
    )
    path = transient_file(tmp_path / "step.csv", TIME, RISE)
    with pytest.raises(kc.errors.UsageError, match="a file, not a directory"):
        reduce_file(path, path, power=2.0)


def test_two_temperatures_are_ambiguous(tmp_path):
    path = tmp_path / "two.csv"
    rows = "".join(f"{t},{y},{2 * y}\n" for t, y in zip(TIME, RISE, strict=True))
    path.write_text("time_s,tj_k,tc_k\n" + rows)
    with pytest.raises(kc.errors.UsageError, match="can be read in more than one way"):
        read_transient(path)


@pytest.mark.parametrize("option", ["power", "network"])
def test_options_of_transients_do_not_apply_to_impedances(tmp_path, option):
    path = tmp_path / "part.csv"
    path.write_text("frequency_hz,real_ohm,imag_ohm\n" + "1000,1,2\n2000,1,4\n" * 10)
    with pytest.raises(kc.errors.UsageError, match="only to a thermal transient"):
        reduce_file(path, tmp_path / "out", **{option: "foster"})


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("T (K)", ("temperature", 1.0)),
        ("t (s)", ("time", 1.0)),
        ("Zth(j-c) (K/W)", ("zth", 1.0)),
        ("Z (mK/W)", ("zth", 1e-3)),
        ("Cs (nF)", ("cs", 1e-9)),
        ("Trace th (deg)", ("phase", np.pi / 180)),
    ],
)
def test_units_distinguish_equal_letters(text, meaning):
    title = read_title(text)
    assert (title.meaning.quantity, title.unit.value) == (meaning[0], pytest.approx(meaning[1]))
