"""A third-party circuit that could act on the machine is refused; an honest one is not."""

import pytest
from support import (
    Deck,
    UsageError,
    explain_unsafe_name,
    load_scene,
    read_checked_circuit,
    read_included_netlist,
    require_valid_wiring,
    verify_scenes,
)

AMPLIFIER = """* a vendor's amplifier
.subckt amp inp inn out
R1 inp inn 1Meg
E1 out 0 inp inn 1e5
.ends amp
"""

HOSTILE = {
    "control block": ".control\nshell touch pwned\n.endc",
    "control in capitals": ".CONTROL\necho\n.ENDC",
    "control in mixed case": ".CoNtRoL\necho\n.EnDc",
    "control behind blanks": "   \t.control\necho",
    "control behind a plus": "R1 a b 1\n+.control\n+ shell id",
    "control on a continuation": "R1 a b 1\n+ 2\n  +  .control",
    "control behind a semicolon": ";.control\nshell id",
    "control behind a dollar": "$ .control\nshell id",
    "control behind a form feed": "* text\x0c.control\nshell id",
    "control behind a vertical tab": "* text\x0b.control",
    "control behind a line separator": "* text\u2028.control",
    "control behind a carriage return": "* text\r.control\rshell id",
    "bare shell": "shell rm -rf ~",
    "bare Shell in capitals": "SHELL id",
    "bare change of the folder": "cd ..",
    "bare load": "load /etc/passwd",
    "bare source": "source evil.sp",
    "bare code model": "codemodel ./evil.cm",
    "bare unset": "unset a b",
    "bare quit": "quit",
    "comment that is a command": "*#shell id",
    "comment that makes a script": "*ng_script\nshell id",
    "command comment behind blanks": "  *# shell id",
    "code model": "codemodel ./evil.cm",
    "code model command": ".codemodel evil.cm",
    "pre_codemodel": "pre_codemodel evil.cm",
    "loads OSDI": "pre_osdi evil.osdi",
    "absolute include": ".include /etc/passwd",
    "absolute include in quotes": '.include "/etc/passwd"',
    "parent include": ".include ../secret.lib",
    "hidden parent include": ".include models/../../secret.lib",
    "include with continuation": ".include\n+ /etc/passwd",
    "short include": ".inc /etc/passwd",
    "include in capitals": ".INCLUDE /etc/passwd",
    "home include": ".include ~/.ssh/id_rsa",
    "variable include": ".include $HOME/x.lib",
    "drive include": ".include C:\\x.lib",
    "backslash parent include": ".include ..\\x.lib",
    "share include": ".include \\\\server\\x.lib",
    "address include": ".include http://example.org/x.lib",
    "lib chain": ".lib models.lib typical",
    "lib section": ".lib typical\nR1 a b 1\n.endl",
    "lib in capitals": ".LIB '/etc/passwd' x",
    "back quotes": "R1 a b `id`",
    "file source": "A1 %v[a] src\n.model src filesource(file=\"/etc/passwd\")",
    "process model": ".model p d_process(process_file=\"/bin/sh\")",
    "co-simulation": ".model p d_cosim(simulation=\"./evil.so\")",
    "waveform file": "V1 a 0 PWL(file=/etc/passwd)",
    "wave file": "V1 a 0 wavefile=../x.wav chan=0",
    "table file": "B1 a 0 V=tablefile(\"/etc/passwd\")",
    "table from a file": "B1 a 0 V={table(\"/etc/passwd\")}",
    "output bias file": ".savebias x.txt",
    "unknown command": ".exec id",
    "tab behind the include": ".include\t../payload.lib extra.lib",
    "option that is a variable of the shell": ".options editor=./evil",
    "blank that is none to the simulator": ".op\xa0x",
    "form feed behind the include": ".include\x0c../evil.lib",
    "zero byte": "R1 a b 1\0\n.tran 1 1",
    "script machinery": "set filetype=ascii",
    "write": "write x.txt v(a)",
}  # fmt: skip

BENIGN = {
    "amplifier": AMPLIFIER,
    "capitals": AMPLIFIER.upper(),
    "Windows line ends": AMPLIFIER.replace("\n", "\r\n"),
    "old Mac line ends": AMPLIFIER.replace("\n", "\r"),
    "comment about control": "* the .control block of the data sheet\n" + AMPLIFIER,
    "comment about shell": "* shell-type core, see /usr/share\n" + AMPLIFIER,
    "comment with back quote": "* the part's `A' grade\n" + AMPLIFIER,
    "comment with a path": "* .include ../old.lib was here\n" + AMPLIFIER,
    "inline comment": "R1 a b 1k ; shell and .control are words\n",
    "dollar comment": "R1 a b 1k $ source of noise\n",
    "micro sign": "C1 a b 1u ; µF, 25 °C\n",
    "non-breaking space": "* 10\u00a0µF\nC1 a b 10u\n",
    "diode model": "D1 a b DX\n.model DX D(IS=1e-14 RS=1)\n",
    "bipolar model": ".model QN NPN(BF=100\n+ VAF=50)\nQ1 c b e QN\n",
    "field effect model": "M1 d g s b MN W=1u L=1u\n.model MN NMOS(VTO=1)\n",
    "switch": "S1 a b c d SW1\n.model SW1 SW(VT=1 VH=0.1)\n",
    "behaviour": "B1 a 0 V={V(b)*2+max(V(c),0)}\n",
    "table": "B1 a 0 V={table(V(b),0,0,1,1)}\n",
    "pwl source": "V1 a 0 PWL(0 0 1m 1)\n",
    "params": ".subckt x a b PARAMS: r=1k\nR1 a b {r}\n.ends\n",
    "nested": ".subckt o a\n.subckt i b\nR1 b 0 1\n.ends\nX1 a i\n.ends\n",
    "function": ".func sq(x) {x*x}\n.param a={sq(2)}\n",
    "options and temperature": ".options reltol=1e-4\n.temp 27\n",
    "initial conditions": ".ic V(a)=1\n.nodeset V(b)=2\nC1 a b 1u\n",
    "analysis and end": "V1 a 0 1\nR1 a 0 1\n.tran 1u 1m\n.save v(a)\n.end\n",
    "measure": ".meas tran peak MAX V(a)\n",
    "transmission line": "T1 a 0 b 0 Z0=50 TD=1n\n",
    "coupled coils": "L1 a 0 1m\nL2 b 0 1m\nK1 L1 L2 0.9\n",
    "controlled sources": "V1 a 0 0\nF1 b 0 V1 2\nH1 c 0 V1 3\nG1 d 0 a b 1\nE1 e 0 a b 1\n",
    "part called like a command": "Rshell a b 1\nCsource a b 1u\nXcontrol a b amp\n",
    "capacitor named like a command": ".subckt x a b\nCd a b 1n\nCd2 a b {1n}\n.ends\n",
    "coil named like a command": "LOAD a b 1m\nRb b 0 1\n",
    "switches named like commands": "Set a b c d SM\nShell a b c d SM\nWrite a b V1 WM\n",
    "sources named like commands": "Exit a 0 b 0 2\nHardcopy a 0 V1 2\n",
    "transistor named like a command": "Quit c b e QM\n",
    "node called like a command": "R1 shell control 1\n",
    "empty": "",
    "only comments": "* nothing\n* at all\n",
}


@pytest.fixture
def user(tmp_path):
    """Writes files by their names and checks the first of them."""

    def check(files, **more):
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(text.encode())
        return read_checked_circuit(tmp_path / next(iter(files)), **more)

    return check


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_hostile_circuits_are_refused(text, user):
    with pytest.raises(UsageError) as caught:
        user({"user.lib": AMPLIFIER + text + "\n"})
    assert caught.value.exit_code == 2
    assert "user.lib" in str(caught.value)


CODE_MODELS = (
    "d_process", "d_cosim", "filesource", "d_source", "d_state", "table2d", "table3d"
)  # fmt: skip


@pytest.mark.parametrize("model", CODE_MODELS)
def test_code_models_that_open_files_or_start_programs_are_refused_by_their_name(model, user):
    """Without one of the parameters that name a file, which the scan refuses for themselves."""
    with pytest.raises(UsageError, match="code model"):
        user({"user.lib": f"{AMPLIFIER}.model p {model} (delay=1n)\n"})


@pytest.mark.parametrize("name", ["control block", "parent include", "waveform file", "zero byte"])
def test_hostile_decks_are_not_verified(name, tmp_path):
    """Neither their own lines nor those of what they include, however that is written."""
    text = HOSTILE[name]
    (tmp_path / "part.lib").write_bytes((AMPLIFIER + text + "\n").encode())
    deck = tmp_path / "deck.cir"
    for line in (".include\tpart.lib", f".inc\t{tmp_path}/part.lib", AMPLIFIER + text):
        deck.write_bytes(f"* deck\n{line}\n.end\n".encode())
        with pytest.raises(UsageError) as caught:
            verify_scenes([load_scene("harmonic")], tmp_path / "out", deck=deck)
        assert "deck.cir" in caught.value.where
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", BENIGN.values(), ids=BENIGN)
def test_benign_circuits_pass(text, user):
    found = user({"user.lib": text})
    assert found.file == "user.lib"
    assert "\r" not in found.text
    user({"user.lib": found.text})


def test_the_line_is_named(user):
    with pytest.raises(UsageError, match=r"user\.lib:7") as caught:
        user({"user.lib": AMPLIFIER + "* one more\n.control\n.endc\n"})
    assert caught.value.got == ".control"
    assert "--trust" in str(caught.value.hint)


@pytest.mark.parametrize(("line", "action"), [
    ("cd ..", "Cd NODE1 NODE2 VALUE"), ("Load a b", "Load NODE1 NODE2 VALUE"),
    ("shell id", "Shell NODE1 NODE2 NODE3 NODE4 VALUE"),
])  # fmt: skip
def test_an_incomplete_element_named_like_a_command_gets_its_form(line, action, user):
    """A line with the proposed form passes, because ngspice reads the line as an element."""
    with pytest.raises(UsageError, match="has the command") as caught:
        user({"user.lib": AMPLIFIER + line + "\n"})
    assert action.lower() in caught.value.hint.lower()
    assert "--trust" not in caught.value.hint
    element = caught.value.hint.rpartition("write  ")[2]
    user({"user.lib": AMPLIFIER + element.replace("VALUE", "1n") + "\n"})


def test_trust_does_not_change_the_circuit(user):
    found = user({"user.lib": AMPLIFIER + ".control\n.endc\n"}, trust=True)
    assert ".control" in found.text


def test_included_files_come_along_and_are_scanned(user):
    main = {"user.cir": ".include models/amp.lib\nX1 a b c amp\n"}
    text = f"* begin of models/amp.lib\n{AMPLIFIER}\n* end of models/amp.lib\nX1 a b c amp\n"
    assert user(main | {"models/amp.lib": AMPLIFIER}).text == text
    with pytest.raises(UsageError, match=r"amp\.lib:6"):
        user(main | {"models/amp.lib": AMPLIFIER + ".control\n"})


def test_paths_are_relative_to_their_file(user):
    text = user({
        "user.cir": "* user\n.include models/amp.lib\nV1 a 0 1\nR2 c 0 1\nX1 a 0 c amp\n",
        "models/amp.lib": ".include inner.lib\n" + AMPLIFIER,
        "models/inner.lib": "* inner\n",
    }).text  # fmt: skip
    assert "\n* inner\n" in text
    require_valid_wiring(Deck(name="user", text=text))


@pytest.mark.parametrize(
    "card",
    [
        ".include inner.lib", ".INCLUDE inner.lib", ".inc\tinner.lib", "\t .include\t\tinner.lib  ",
        ".includeX inner.lib", ".incore 'inner.lib'", '.include "inner.lib"',
        ".include ./inner.lib", ".include inner.lib ; a comment", ".include inner.lib $ a comment",
        '.include "two words.lib"', ".include sub/../inner.lib", ".include inner.lib other.lib",
        ".include ~/inner.lib",
    ],
)  # fmt: skip
def test_no_include_is_left_for_the_simulator(card, user):
    inner = dict.fromkeys(("inner.lib", "two words.lib"), "Rinner a 0 1\n")
    files = {"user.cir": f"* user\n{card}\nR2 a 0 1\n", **inner}
    if any(word in card for word in ("..", "~", "other")):
        with pytest.raises(UsageError, match="includes"):
            user(files)
        return
    text = user(files).text
    assert "\nRinner a 0 1\n" in text
    assert ".inc" not in text.lower()


def test_a_circuit_includes_files_of_its_folder(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "user.cir").write_text(".include inner.lib\n")
    (tmp_path / "sub" / "inner.lib").write_text(".param a=1\n")
    (tmp_path / "inner.lib").write_text(".param a=2\n")
    expected = "* begin of inner.lib\n.param a=1\n\n* end of inner.lib\n"
    found = read_included_netlist("sub/user.cir", tmp_path)
    assert (found.file, found.text) == ("user.cir", expected)


def test_commands_in_included_netlists_are_rejected(tmp_path):
    (tmp_path / "user.cir").write_text(".control\n.endc\n")
    with pytest.raises(UsageError, match="control"):
        read_included_netlist("user.cir", tmp_path)


MULTIPLIED = {f"{i}.lib": f".include {i + 1}.lib\n" * 2 for i in range(10)}


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"user.lib": "V1 a 0 PWL\n.include inner.lib\n", "inner.lib": '+ file="/etc/passwd"\n'},
         "reads or writes a file"),  # a card that goes on over two files
        ({"a.lib": ".include b.lib\n", "b.lib": ".include a.lib\n"}, "includes itself"),
        (MULTIPLIED | {"10.lib": "* end\n"}, "too many files"),
        ({"user.cir": ".include missing.lib\n"}, "this file cannot be included"),
        ({"user.cir": ".include .\n"}, "this file cannot be included"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_included_are_rejected(files, said, user):
    with pytest.raises(UsageError, match=said):
        user(files)


@pytest.mark.parametrize(
    "name",
    ["/etc/passwd", "../x.lib", "a/../../x.lib", "x.lib\n.control", "x\t.lib", "x\0.lib",
     "~/x.lib", "$HOME.lib", "`id`.lib", "-x.lib", "x.lib ", "", "c:x.lib", "a\\b.lib",
     "x.lib\u2028"],
)  # fmt: skip
def test_names_in_a_scene_cannot_leave_its_folder(name):
    assert explain_unsafe_name(name)
    home = load_scene("bring_your_own").home
    with pytest.raises(UsageError) as caught:
        read_included_netlist(name, home)
    assert caught.value.exit_code == 2
    assert "the name of an included file is not allowed" in str(caught.value)
    with pytest.raises(UsageError):
        load_scene("bring_your_own", {"include": [name]})


def test_links_do_not_lead_out(tmp_path):
    secret = tmp_path / "secret.lib"
    secret.write_text("R1 a b 1\n")
    home = tmp_path / "home"
    home.mkdir()
    (home / "link.lib").symlink_to(secret)
    (home / "user.cir").write_text(".include link.lib\n")
    with pytest.raises(UsageError, match="outside of the directory"):
        read_checked_circuit(home / "user.cir")


def test_pins_are_read_only_from_files_beside_the_scene(tmp_path):
    """A scene is read before anybody said that its circuits are trusted."""
    (tmp_path / "outside.lib").write_text(".subckt mine a b c\nR1 a b 1\n.ends\n")
    home = tmp_path / "home"
    home.mkdir()
    (home / "beside.lib").write_text(".subckt mine a b c\nR1 a b 1\n.ends\n")
    scene = (
        "[own]\npart = 'netlist'\nfile = 'own.lib'\nsubckt = 'mine'\n"
        "pins = { a = 'gnd', b = 'gnd', c = 'gnd' }\n"
    )
    (home / "s.toml").write_text(scene)
    (home / "own.lib").write_text(".include beside.lib\n")
    assert load_scene(home / "s.toml").get_net("own", "a") == "0"
    for elsewhere in ("../outside.lib", tmp_path / "outside.lib"):
        (home / "own.lib").write_text(f"* again\n.include {elsewhere}\n")
        with pytest.raises(UsageError, match="no such subcircuit"):
            load_scene(home / "s.toml")
