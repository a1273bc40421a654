"""The public face: what an import loads, what is found there, and that results are whole."""

import inspect
import json
import os
import re
import subprocess
import sys
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
import pytest
from support import PointResult

import kc2spice as kc

ROOT = Path(__file__).parents[2]
CONTRACT = (
    "load_scene", "run", "build", "LinearModel", "Port", "read_model", "reduce", "subcircuit",
    "read_lib", "deck", "simulate", "sweep", "register_part", "errors", "Result",
)  # fmt: skip
CIRCUIT = {
    "name": "divider",
    "drive": {"part": "source", "ac": "1 V", "dc": "1 V"},
    "upper": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}},
    "store": {"part": "capacitor", "capacitance": "1 uF", "pins": {"a": "upper.b"}},
}
PULSE = {
    **CIRCUIT,
    "drive": {
        "part": "source",
        "pulse": {"high": "1 V", "start": "1 ms", "width": "20 ms", "edge": "1 us"},
    },
    "analysis": {"type": "transient", "stop": "6 ms"},
    "probes": {"top_v": {"of": "store.v", "take": "max"}},
}


def fresh(code):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    return done.stdout.split()


def test_import_loads_nothing_else():
    loaded = fresh("import sys, kc2spice; print(*sys.modules)")
    own = {name for name in loaded if name.startswith("kc2spice")}
    assert own == {"kc2spice", "kc2spice.core"}
    heavy = {"numpy", "scipy", "pydantic", "gmsh", "PySpice", "matplotlib", "skfem", "typer"}
    assert not heavy & set(loaded)


def test_loading_a_scene_needs_no_plots_and_no_mesher():
    loaded = fresh(
        "import sys, kc2spice as kc; kc.load_scene('kick_and_catch'); print(*sys.modules)"
    )
    assert not {"gmsh", "PySpice", "matplotlib"} & set(loaded)


def test_every_public_name_exists_and_has_a_docstring():
    assert set(CONTRACT) <= set(kc.__all__) <= set(dir(kc))
    for name in kc.__all__:
        assert inspect.getdoc(getattr(kc, name)), name
    with pytest.raises(AttributeError, match="nothing_like_this"):
        kc.nothing_like_this  # noqa: B018


def test_transient_against_the_closed_form():
    result = kc.run(PULSE)
    late = result.time > 1.01e-3
    wanted = 1 - np.exp(-(result.time[late] - 1.0005e-3) / 1e-3)
    np.testing.assert_allclose(result.waves["store.v"][late], wanted, atol=2e-3)
    assert result.units["store.v"] == "V"
    assert result.metrics["top_v"] == pytest.approx(1 - np.exp(-5), rel=1e-3)
    assert "top_v" in repr(result)
    assert "<td>top_v</td>" in result._repr_html_()
    with pytest.raises(kc.errors.UsageError, match="not a function of frequency"):
        _ = result.frequency


def test_ac_against_the_closed_form():
    scene = kc.load_scene(
        {**CIRCUIT, "analysis": {"type": "ac", "start": 10, "stop": 1e4, "points": 50}}
    )
    result = kc.run(scene)
    wanted = 1 / (1 + 2j * np.pi * result.frequency * 1e-3)
    np.testing.assert_allclose(result.waves["store.v"], wanted, rtol=1e-6)


def test_the_saved_result_equals_the_returned_result(tmp_path):
    result = kc.run(PULSE, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["metrics"] == pytest.approx(dict(result.metrics))
    assert set(record["files"]) == {path.name for path in (tmp_path / "out").iterdir()}
    with np.load(tmp_path / "out" / "waveforms.npz") as saved:
        assert set(saved.files) == set(result.waves)
        np.testing.assert_array_equal(saved["store.v"], result.waves["store.v"])


def test_a_directory_that_cannot_be_written_is_noticed_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("kc2spice.api.complete_run", lambda *_, **__: pytest.fail("it was run"))
    (tmp_path / "out").write_text("a file")
    with pytest.raises(kc.errors.UsageError, match="a file, not a directory"):
        kc.run(PULSE, tmp_path / "out")


def test_plots_show_waves_and_refuse_others(tmp_path):
    result = kc.run(PULSE)
    figure = result.plot("store.v", "upper.i")
    assert [axes.get_ylabel() for axes in figure.axes] == ["value in V", "value in A"]
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), result.waves["store.v"])
    assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(kc.errors.UsageError, match=r"store\.v"):
        result.plot("store.w")


def test_sweep_has_a_row_for_each_point_and_the_reason_of_a_failure(tmp_path):
    table = kc.sweep(
        PULSE, {"upper.resistance": [500, "1 kOhm"], "store.capacitance": [1e-6, 2e-6]}
    )
    assert table.columns == ("upper.resistance", "store.capacitance", "top_v", "status")
    wanted = [1 - np.exp(-5e-3 / (r * c)) for r in (500, 1e3) for c in (1e-6, 2e-6)]
    np.testing.assert_allclose(table["top_v"], wanted, rtol=1e-3)
    assert table["status"] == ["ok"] * 4
    lines = table.save(tmp_path / "t.csv").read_text().splitlines()
    assert lines[0] == "upper.resistance,store.capacitance,top_v,status"
    assert len(lines) == 5
    assert table[1]["store.capacitance"] == 2e-6
    assert repr(table).splitlines()[0].split() == list(table.columns)
    with pytest.raises(kc.errors.UsageError, match="out of range"):
        kc.sweep(PULSE, {"upper.resistance": [1.0, -1.0]})
    with pytest.raises(kc.errors.UsageError, match="no key has more than one value"):
        kc.sweep(PULSE, {"upper.resistance": []})


def test_a_sweep_becomes_a_dataframe_with_nan_where_a_point_failed():
    pandas = pytest.importorskip("pandas", reason="pip install 'kc2spice[dataframes]'")
    rows = [
        {"r": 500.0, "top_v": 0.5, "status": "ok"},
        {"r": 1e3, "top_v": None, "status": "failed: x"},
    ]
    frame = kc.Table(rows).to_dataframe()
    assert list(frame.columns) == ["r", "top_v", "status"]
    assert frame["top_v"].dtype == np.float64
    assert pandas.isna(frame["top_v"][1])
    assert frame.set_index("r")["top_v"][500.0] == 0.5
    assert not kc.Table([{"r": 1.0, "status": "ok"}]).to_dataframe().isna().any(axis=None)


def test_waves_become_an_xarray_with_units_and_the_charge_of_the_capacitor():
    pytest.importorskip("xarray", reason="pip install 'kc2spice[dataframes]'")
    result = kc.run(PULSE)
    waves = result.to_xarray()
    assert list(waves.coords) == ["time"]
    assert waves["time"].attrs["units"] == "s"
    assert waves["store.v"].attrs["units"] == "V"
    np.testing.assert_array_equal(waves["store.v"], result.waves["store.v"])
    charge = waves["upper.i"].integrate("time")
    assert abs(float(charge)) == pytest.approx(1e-6 * (1 - np.exp(-5)), rel=1e-3)
    band = {"type": "ac", "start": "100 Hz", "stop": "200 Hz", "points": 3}
    response = kc.run({**CIRCUIT, "analysis": band}).to_xarray()["store.v"]
    wanted = 1 / (1 + 2j * np.pi * response["frequency"] * 1e-3)
    np.testing.assert_allclose(response, wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("method", "package"), [("to_dataframe", "pandas"), ("to_xarray", "xarray")]
)
def test_a_missing_package_is_named_with_its_pip_line(monkeypatch, method, package):
    monkeypatch.setitem(sys.modules, package, None)
    owner = kc.Table([{"r": 1.0, "status": "ok"}])
    if method == "to_xarray":
        owner = kc.run({**CIRCUIT, "analysis": {"type": "op"}, "probes": {"v": {"of": "store.v"}}})
    with pytest.raises(kc.errors.MissingToolError, match=f"{package} is not installed") as caught:
        getattr(owner, method)()
    assert caught.value.hint == "pip install 'kc2spice[dataframes]'"


def test_the_library_logs_its_stages_and_prints_nothing(caplog, capfd):
    with caplog.at_level("INFO", logger="kc2spice"):
        kc.run({**CIRCUIT, "analysis": {"type": "op"}, "probes": {"v": {"of": "store.v"}}})
    stages = [record.getMessage().split(":")[0] for record in caplog.records]
    assert "simulate" in stages
    assert not any("took" in record.getMessage() for record in caplog.records)
    assert capfd.readouterr().out == ""


def test_a_point_has_one_value_and_that_is_its_mean():
    probes = {take: {"of": "store.v", "take": take} for take in ("mean", "rms", "final")}
    result = kc.run({**CIRCUIT, "analysis": {"type": "op"}, "probes": probes})
    assert dict(result.metrics) == pytest.approx({"mean": 1.0, "rms": 1.0, "final": 1.0})


def test_a_sweep_without_a_number_ends_at_the_first_good_point():
    class Done(Executor):
        """One worker, whose first point fails; the others have curves alone."""

        outcomes = iter([PointResult(failure="not this one"), PointResult()])

        def submit(self, *_):
            future = Future()
            future.set_result(next(self.outcomes))
            return future

    with pytest.raises(kc.errors.UsageError, match="no metric that is a number"):
        kc.sweep(PULSE, {"upper.resistance": [1.0, 2.0]}, executor=Done(), workers=1)


def test_overrides_of_a_loaded_scene_keep_those_before():
    scene = kc.load_scene(kc.load_scene(PULSE, {"upper.resistance": 7.0}), {"analysis.stop": 1e-3})
    assert scene.parts["upper"].keys.resistance == 7.0
    assert scene.stop_time == 1e-3
    assert kc.load_scene(scene) is scene


def edited(tmp_path, change):
    deck = kc.deck(PULSE)
    path = tmp_path / deck.main_file_name
    path.write_text(change(deck.files[deck.main_file_name]))
    return path


def test_edited_deck_gets_the_metrics_of_its_scene(tmp_path):
    same = kc.run(PULSE, deck=edited(tmp_path, str))
    assert same.metrics["top_v"] == pytest.approx(1 - np.exp(-5), rel=1e-3)
    path = edited(tmp_path, lambda text: re.sub(r"(?m)^(Rupper .*) \S+$", r"\1 2k", text))
    done = kc.run(PULSE, tmp_path / "out", deck=path)
    assert done.metrics["top_v"] == pytest.approx(1 - np.exp(-2.5), rel=1e-3)
    assert " 2k" in (tmp_path / "out" / path.name).read_text()


def test_a_driver_that_replaces_a_source_is_not_compared_with_its_keys(tmp_path):
    """The source's card stays as an ammeter; what it gave is no longer what drives."""

    def change(text):
        card = next(line for line in text.splitlines() if line.startswith("Vdrive "))
        return text.replace(card, f"Vdrive {card.split()[1]} mine 0\nVmine mine 0 0.5")

    done = kc.run(PULSE, deck=edited(tmp_path, change))
    assert done.metrics["top_v"] == pytest.approx(0.5, rel=1e-2)
    assert not done.checks
    labels = {check["name"]: check["label"] for check in kc.run(PULSE).record["checks"]}
    assert labels["drive drives as defined"] == "waveform error of drive"
    assert labels["time steps compared with the exact solution"] == "time-step error"


def test_a_small_deck_without_its_source_gets_the_card_that_measures_the_current(tmp_path):
    """The error does not state that the deck is of another scene, and the advised card works."""
    scene = {
        "drive": {"part": "source", "dc": "1 V", "pins": {"out": "load.a"}},
        "load": {"part": "resistor", "resistance": "1 kOhm"},
        "probes": {"voltage": {"of": "load.v", "take": "final"}},
        "analysis": {"type": "op"},
    }
    deck = kc.deck(scene)
    own_driver = deck.files[deck.main_file_name].replace("drive_out 0", "mine 0")
    own_driver = own_driver.replace("Vdrive mine 0 DC 1", "Vmine mine 0 DC 0.5")
    path = tmp_path / deck.main_file_name
    path.write_text(own_driver)
    with pytest.raises(kc.errors.UsageError, match="nodes or devices that this deck does") as found:
        kc.run(scene, deck=path)
    card = found.value.hint.rpartition(":  ")[2].replace("NODE", "mine")
    path.write_text(own_driver.replace("Vmine", f"{card}\nVmine", 1))
    assert kc.run(scene, deck=path).metrics["voltage"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace(".save v(store_a)\n", "").replace(".save v(upper_b)\n", ""),
         "does not save"),
        (lambda text: text.replace(".tran", ".op\n*"), "differs from that of the scene"),
        (lambda text: text.replace(".end", ".control\nshell ls\n.endc\n.end"), "control"),
    ],
)  # fmt: skip
def test_edited_deck_is_refused_with_the_reason(tmp_path, change, said):
    with pytest.raises(kc.errors.UsageError, match=said):
        kc.run(PULSE, deck=edited(tmp_path, change))


def test_libraries_written_are_read_back(tmp_path):
    k = np.diag([4e6, 9e6])
    model = kc.LinearModel(M=np.eye(2), K=k, B=np.ones((2, 1)), rayleigh=(0.0, 1e-6),
                           ports=[kc.Port("tip", "mechanical")])  # fmt: skip
    part = kc.subcircuit(kc.reduce(model, order=2, band=(0, 1e3)), "pair")
    assert kc.read_lib(part.write(tmp_path))[0].pins == part.pins
    assert (tmp_path / "pair.lib").read_text() == part.text
    assert "tip[um/N]" in repr(part)
