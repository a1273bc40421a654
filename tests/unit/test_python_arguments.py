"""Wrong arguments of Python calls raise errors whose advice works, and none is ignored."""

import ast
import inspect
import pickle
from pathlib import Path

import numpy as np
import pytest
from messages import fails
from small_scenes import LAMP
from support import AdvisesOnAttributes

import kc2spice as kc

LOOP = {
    "name": "loop",
    "brain": {"part": "controller", "inputs": ["level"], "units": {"level": "V"}, "period": "1 ms",
              "pins": {"level": "drive.out", "out": "load.a"}},
    "drive": {"part": "source", "dc": "1 V"},
    "load": {"part": "resistor", "resistance": "1 kOhm"},
    "analysis": {"type": "transient", "stop": "5 ms"},
    "probes": {"last_v": {"of": "load.v", "take": "final"}},
}  # fmt: skip
KEY = "lamp.resistance"


def disc(quality=50.0):
    layers = [
        {"diameter": "20 mm", "thickness": "0.2 mm", "material": "brass"},
        {"diameter": "14 mm", "thickness": "0.2 mm", "material": "PZT-5A"},
    ]
    return {"disc": {"part": "disc", "layers": layers, "damping": {"quality": quality}}}


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """A file of the impedance of the disc with a Q factor of 45."""
    monkeypatch.chdir(tmp_path)
    f = np.linspace(4e3, 9e3, 60)
    model = kc.build(disc(45.0))["disc"].select(["anode"])
    z = 1 / (2j * np.pi * f * model.transfer(f)[:, 0, 0])
    table = np.column_stack([f, z.real, z.imag])
    np.savetxt("disc.csv", table, delimiter=",", header="frequency_hz,real_ohm,imag_ohm")
    return table


@pytest.mark.parametrize("workers", [1.5, 0, -1, True, "2", float("nan")])
def test_the_number_of_workers_is_a_whole_number(workers):
    error = fails(kc.sweep, LAMP, {KEY: [3, 6]}, workers=workers)
    assert error.where == "workers"
    assert error.got == repr(workers)
    assert error.hint == "for example workers=2"
    assert kc.sweep(LAMP, {KEY: [3, 6]}, workers=2)["current_a"] == pytest.approx([4, 2])
    assert len(kc.sweep(LAMP, {KEY: [3]}, workers=np.int64(1))) == 1


def test_an_executor_or_a_progress_function_of_a_wrong_type_is_an_error():
    assert fails(kc.sweep, LAMP, {KEY: [3]}, executor=4).where == "executor"
    assert fails(kc.sweep, LAMP, {KEY: [3]}, progress=True).where == "progress"


@pytest.mark.parametrize(
    ("text", "currents"),
    [("3:6:2", [4, 2]), ("log:3:12:3", [4, 2, 1]), ("3,6", [4, 2]), ("3 Ohm:6 Ohm:2", [4, 2]),
     ("6 Ohm", [2])],
)  # fmt: skip
def test_the_advice_for_a_range_as_text_is_a_list_of_its_values(text, currents):
    hint = fails(kc.sweep, LAMP, {KEY: text}).hint
    values = eval(
        hint[hint.index(" ") :].split(" for ")[0].split("such as ")[-1].strip(), {"numpy": np}
    )
    assert kc.sweep(LAMP, {KEY: values})["current_a"] == pytest.approx(currents)


def test_a_table_is_written_in_the_format_of_its_suffix(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = kc.sweep(LAMP, {KEY: [3, 6]})
    error = fails(table.save, "lamp.xlsx")
    assert "in the format .xlsx" in error.message
    assert error.hint.startswith('write "lamp.csv"')
    assert not list(tmp_path.iterdir())
    for name in ("lamp.csv", "lamp", "lamp.v2", "deep/er/lamp.dat"):
        assert table.save(name).read_text().startswith("lamp.resistance,current_a,status\n3,4")
    assert fails(table.save, "deep").got == "Is a directory"
    assert fails(table.save, "lamp.csv/x.csv").where == "lamp.csv/x.csv"
    assert fails(table.save, 3).got == "3"


def test_a_table_saved_in_parquet_has_the_same_values(tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    path = kc.sweep(LAMP, {KEY: [3, 6]}).save(tmp_path / "lamp.parquet")
    assert list(pandas.read_parquet(path)["current_a"]) == pytest.approx([4, 2])


def test_an_empty_table_has_no_columns():
    assert kc.Table([]).columns == ()


def test_a_library_is_written_into_a_new_folder(tmp_path):
    mass = kc.LinearModel(M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)))
    part = kc.subcircuit(mass, "chain")
    path = part.write(tmp_path / "new" / "x.lib")
    assert path.read_text() == part.text
    assert part.write(tmp_path).name == "chain.lib"
    assert fails(part.write, path / "y.lib").hint == "choose another path"


@pytest.mark.parametrize("dialect", [None, 3, ["ngspice"]])
def test_a_dialect_that_is_not_a_string_is_an_error(tmp_path, dialect):
    error = fails(kc.export, LAMP, tmp_path / "out", dialect=dialect)
    assert error.where == "dialect"
    assert error.got == repr(dialect)
    assert "'ngspice'" in error.hint
    kc.export(LAMP, tmp_path / "out", dialect="ngspice")


def test_a_function_of_an_unknown_controller_is_an_error():
    error = fails(kc.run, LAMP, functions={"pid": lambda time, inputs: 0.0})
    assert error.where == "functions"
    assert error.hint == "leave out functions"
    error = fails(kc.run, LOOP, functions={"brian": lambda time, inputs: 0.0})
    assert error.hint == "did you mean 'brain'?"
    assert fails(kc.run, LOOP, functions={"brain": 3}).where == "functions: brain"
    assert fails(kc.run, LOOP, functions=print).hint == 'write functions={"brain": FUNCTION}'
    result = kc.run(LOOP, functions={"brain": lambda time, inputs: 2 * inputs["level"]})
    assert result.metrics["last_v"] == pytest.approx(2.0, rel=1e-6)


def test_a_deck_object_in_a_run_is_an_error_that_advises_simulate(tmp_path):
    deck = kc.deck(LAMP)
    error = fails(kc.run, LAMP, deck=deck)
    assert error.hint == "to simulate a deck without a file, write kc.simulate(DECK)"
    assert kc.simulate(deck).waves["lamp.i"][0] == pytest.approx(2.0)
    assert fails(kc.verify, LAMP, 3).where == "out"
    assert fails(kc.run(LAMP).save, 3).where == "out"


@pytest.mark.parametrize("value", ["False", 1, None])
def test_a_switch_is_true_or_false(tmp_path, value):
    for call in (kc.run, kc.deck, kc.verify):
        assert fails(call, LAMP, trust=value).where == "trust"
    assert fails(kc.export, LAMP, tmp_path / "out", trust=value).where == "trust"
    assert fails(kc.verify, LAMP, full=value).hint == "write full=False, or full=True"
    assert kc.deck(LAMP, trust=np.bool_(False)).name == "lamp"


@pytest.mark.parametrize("timeout", ["3 s", 0, -1.0, True, float("nan")])
def test_a_time_limit_is_a_positive_number(timeout):
    deck = kc.deck(LAMP)
    assert fails(kc.simulate, deck, timeout=timeout).where == "timeout"
    assert kc.simulate(deck, timeout=60).scene == "lamp"


def test_a_command_line_in_an_error_of_a_call_keeps_its_options(cli):
    wrong = {**LAMP, "probes": {"current_a": {"of": "lamp.i", "take": "avg"}}}
    expected = fails(kc.run, wrong).expected
    command = expected.partition("in all: ")[2].rstrip(")")
    assert command == "kc2spice scenes --keys"
    assert cli(*command.split()[1:]).exit_code == 0


@pytest.mark.parametrize(
    ("letter", "matrix"), [("B", [1, 0]), ("C", [1, 0]), ("M", [1, 1]), ("K", np.ones(2))]
)
def test_the_advice_for_a_flat_list_gives_a_matrix(letter, matrix):
    matrices = {"M": np.eye(2), "K": np.eye(2), "B": [[1], [0]], "C": [[1, 0]]}
    error = fails(kc.LinearModel, **matrices | {letter: matrix})
    assert error.message == f"matrix {letter} has 1 dimensions"
    written = eval(error.hint[error.hint.index("np.") :], {"np": np, letter: matrix})
    assert kc.LinearModel(**matrices | {letter: written}).order == 2


def test_rows_of_different_length_are_no_matrix():
    error = fails(kc.LinearModel, M=[[1, 0], [0]], K=np.eye(2), B=[[1], [0]])
    assert error.message == "the rows of matrix M differ in length"


def test_a_binary_file_is_not_suggested_in_place_of_a_toml_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("ok.npz", M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)))
    assert "ok.npz" not in fails(kc.read_model, "ok.npz", sidecar="ok.tml").hint
    Path("ok.toml").write_text('[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n')
    assert fails(kc.read_model, "ok.npz", sidecar="ok.tml").hint == "did you mean 'ok.toml'?"
    assert kc.read_model("ok.npz", sidecar="ok.toml").ports[0].name == "tip"


def test_a_scene_read_as_a_library_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lamp.toml").write_text('title = "lamp on a source"\n')
    error = fails(kc.read_lib, "lamp.toml")
    assert error.message == "this file is a TOML file, not a netlist"


def test_an_unknown_name_in_a_returned_mapping_lists_similar_names():
    for values, name in ((kc.build(disc()), "disk"), (kc.verify(LAMP), "check")):
        with pytest.raises(KeyError) as caught:
            values[name]
        assert "did you mean" in str(caught.value)


def test_ranges_of_a_fit_are_numbers(measured):
    error = fails(kc.fit, disc(), "disc", "disc.csv", {"damping.quality": ("20", "100")})
    assert error.got == "('20', '100')"
    vary = eval(error.hint.removeprefix("write "))
    found = kc.fit(disc(), "disc", "disc.csv", vary)["values"]
    assert found["disc.damping.quality"] == pytest.approx(45.0, rel=1e-4)
    for span in (10, ("a", "b"), (1, float("nan")), (True, 2), (1, 2, 3), "20:100"):
        assert fails(kc.fit, disc(), "disc", "disc.csv", {"damping.quality": span}).got == repr(
            span
        )


def test_the_keys_of_a_fit_are_a_list(measured):
    error = fails(kc.fit, disc(), "disc", "disc.csv", "damping.quality")
    assert error.where == "vary"
    assert error.hint == "write vary=['damping.quality']"
    assert fails(kc.fit, disc(), "disc", "disc.csv", 3).where == "vary"
    assert fails(kc.fit, disc(), "disc", "disc.csv", [3]).where == "vary"
    assert fails(kc.fit, disc(), "disc", "disc.csv", ["zzz"]).hint
    found = kc.fit(disc(), "disc", "disc.csv", ["damping.quality"])["values"]
    assert found["disc.damping.quality"] == pytest.approx(45.0, rel=1e-4)


def test_the_data_of_a_fit_are_a_file_or_a_list_of_tables(measured):
    error = fails(kc.fit, disc(), "disc", measured, ["damping.quality"])
    assert error.where == "data"
    command, _, argument = error.hint.removeprefix("write ").partition(", then pass data=")
    eval(command, {"np": np, "ARRAY": measured})
    found = kc.fit(disc(), "disc", eval(argument), ["damping.quality"])["values"]
    assert found["disc.damping.quality"] == pytest.approx(45.0, rel=1e-4)
    assert fails(kc.fit, disc(), "disc", "disc.csv", ["damping.quality"], out=3).where == "out"
    for data in (3, None, ["disc.csv"], {"file": "disc.csv"}):
        assert fails(kc.fit, disc(), "disc", data, ["damping.quality"]).where == "data"


@pytest.mark.parametrize(
    ("call", "head", "advice"),
    [
        (lambda: kc.run(LAMP, resistance=3), "run: this argument does not exist",
         'overrides={"PART.resistance": 3}'),
        (lambda: kc.run(LAMP, overides={}), "run: this argument does not exist",
         "did you mean 'overrides'?"),
        (lambda: kc.run(LAMP, "out", "own.cir"), "too many arguments", "NAME=VALUE for deck"),
        (lambda: kc.run(LAMP, scene=LAMP), "run: this argument is given twice", "delete scene="),
        (lambda: kc.fit("own.toml", "own.csv", vary=["x"]), "fit: the argument data is missing",
         "write  fit(scene, part, data, vary)"),
    ],
)  # fmt: skip
def test_wrong_arguments_of_a_call_raise_errors_with_advice(call, head, advice):
    with pytest.raises(TypeError) as caught:
        call()
    assert isinstance(caught.value, kc.errors.UsageError)
    assert head in str(caught.value)
    assert advice in caught.value.hint


@pytest.mark.parametrize("name", ["set", "settings", "params"])
@pytest.mark.parametrize("keys", [{KEY: 3}, [f"{KEY}=3"], f"{KEY}=3"])
def test_a_table_of_keys_under_another_name_is_proposed_as_overrides(name, keys):
    with pytest.raises(kc.errors.ArgumentError) as caught:
        kc.load_scene(LAMP, **{name: keys})
    proposal = caught.value.hint.partition("overrides=")[2]
    scene = kc.load_scene(LAMP, overrides=ast.literal_eval(proposal))
    assert scene.get_part("lamp").keys.resistance == 3


def test_all_public_functions_reject_unknown_arguments_with_advice():
    for name in kc.__all__:
        function = getattr(kc, name)
        if inspect.isfunction(function) and not name.startswith("register"):
            with pytest.raises(kc.errors.ArgumentError, match="does not exist"):
                function(unknown_argument=1)
            assert pickle.loads(pickle.dumps(function)) is function


def test_a_warning_about_an_override_names_the_line_of_the_call():
    with pytest.warns(UserWarning, match="replaces it") as found:
        kc.load_scene(LAMP, [f"{KEY}=3", f"{KEY}=4"])
    assert found[0].filename == __file__


@pytest.mark.parametrize("out", [{"lamp.resistance": 3}, 3])
@pytest.mark.parametrize("call", [kc.run, kc.export, kc.verify])
def test_an_output_that_is_no_path_is_an_error_of_all_functions(call, out):
    error = fails(call, LAMP, out)
    assert (error.where, error.message) == ("out", "out is not the path of a directory")
    assert error.got == repr(out)
    with_keys = 'to change keys, write kc.run(SCENE, overrides={"rom.order": 10})'
    assert error.hint == (with_keys if isinstance(out, dict) else 'for example out="results"')


def reduced_chain():
    chain = kc.LinearModel(M=np.eye(4), K=np.diag([1.0, 2, 3, 4]), B=np.ones((4, 1)))
    return kc.reduce(chain, order=2, band=(0, 0.1))


MISSING = {  # object, unknown attribute, and advice that works
    "model": (reduced_chain, ("write", "save", "export", "to_spice", "netlist"),
              'kc.subcircuit(MODEL, "NAME").write("NAME.lib")'),
    "plotted model": (reduced_chain, ("plot",), "MODEL.transfer(FREQUENCIES)"),
    "subcircuit": (lambda: kc.subcircuit(reduced_chain(), "chain"), ("save", "export", "to_spice"),
                   'write("NAME.lib")'),
    "scene": (lambda: kc.load_scene(LAMP), ("write", "save", "export"),
              'kc.export(SCENE, "DIRECTORY")'),
    "scene to run": (lambda: kc.load_scene(LAMP), ("run", "simulate", "plot"), "kc.run(SCENE)"),
    "deck": (lambda: kc.deck(LAMP), ("write", "save", "export"), 'kc.export(SCENE, "DIRECTORY")'),
    "deck to run": (lambda: kc.deck(LAMP), ("run", "plot"), "kc.simulate(DECK)"),
    "result": (lambda: kc.run(LAMP), ("write", "export", "to_csv"), 'save("DIRECTORY")'),
    "table": (lambda: kc.sweep(LAMP, {KEY: [3, 6]}), ("write", "to_csv"), 'save("NAME.csv")'),
}  # fmt: skip


@pytest.mark.parametrize("case", MISSING)
def test_an_unknown_method_names_the_function_to_call(tmp_path, monkeypatch, case):
    make, names, advice = MISSING[case]
    thing = make()
    for name in names:
        assert not hasattr(thing, name)
        with pytest.raises(AttributeError) as caught:
            getattr(thing, name)
        head = f"{type(thing).__name__!r} object has no attribute {name!r}; {advice}"
        assert str(caught.value).startswith(head)
    monkeypatch.chdir(tmp_path)
    own = advice if advice.startswith(("kc.", "MODEL.")) else f"THING.{advice}"
    eval(own, {"kc": kc, "MODEL": thing, "DECK": thing, "THING": thing,
               "SCENE": LAMP if "DECK" in own or case == "deck" else thing,
               "FREQUENCIES": [0.05]})  # fmt: skip


def test_other_unknown_attributes_are_plain_errors():
    model = reduced_chain()
    with pytest.raises(AttributeError, match=r"^'LinearModel' object has no attribute 'ordr'$"):
        model.ordr  # noqa: B018
    assert pickle.loads(pickle.dumps(model)).order == model.order


class Broken(AdvisesOnAttributes):
    @property
    def value(self):
        return self.missing


def test_an_attribute_error_inside_of_a_property_keeps_its_name():
    with pytest.raises(AttributeError, match="'Broken' object has no attribute 'missing'"):
        Broken().value  # noqa: B018
