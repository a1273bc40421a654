"""What ngspice really executes from an included file, the scan refuses."""

import subprocess

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.netlist.scan import third_party
from kc2spice.sim.ngspice import find_ngspice

PREFIXES = ["", " ", "\t", "+", "+ ", ";", "$ ", "$", "#", "//", "*", "* ", "*#", "\x0c", "\x0b",
            "\r", "\xa0", "R9 a 0 1\r", "* text\r", "R9 a 0 1 ; ", "R9 a 0 1 $ "]  # fmt: skip
BLOCKS = [
    "{p}.control\n{p}shell touch pwned\n{p}.endc",
    "{p}.CONTROL\nshell touch pwned\n.ENDC",
    "{p}shell touch pwned",
    "{p}SHELL touch pwned",
    ".control\n{p}shell touch pwned\n.endc",
    ".cont\n+rol\n{p}shell touch pwned\n.endc",
    ".controlled\n{p}shell touch pwned\n.endc",
    "*ng_script\n{p}shell touch pwned",
    ".param x=1\n{p}.exec shell touch pwned",
    ".options post\n{p}*#shell touch pwned",
    ".inc{p} evil.lib",
    ".incl{p}ude evil.lib",
    ".lib{p} evil.lib evil",
    "{p}.include ../evil.lib",
    "{p}.LIB '../evil.lib' evil",
    ".model p d_process(process_file=\"touch pwned\")\n{p}A1 [a] a a [b] p",
    "{p}.save v(a) `touch pwned`",
    "R9 a 0 {p}`touch pwned`",
]  # fmt: skip
EVIL = ".control\nshell touch pwned\n.endc\n.lib evil\n.control\nshell touch pwned\n.endc\n.endl\n"


@pytest.mark.parametrize("block", BLOCKS)
def test_what_acts_is_refused(block, tmp_path):
    acted = 0
    for i, prefix in enumerate(PREFIXES):
        home = tmp_path / str(i)
        home.mkdir()
        text = "* third-party part\nR5 a 0 1\n" + block.replace("{p}", prefix) + "\n"
        (home / "part.lib").write_bytes(text.encode())
        (home / "evil.lib").write_text(EVIL)
        (tmp_path / "evil.lib").write_text(EVIL)
        (home / "deck.cir").write_text("* deck\nV1 a 0 1\nR1 a 0 1\n.include part.lib\n.op\n.end\n")
        subprocess.run(
            [find_ngspice().path, "-b", "-n", "deck.cir"],
            cwd=home, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=20,
        )  # fmt: skip
        if (home / "pwned").exists():
            acted += 1
            with pytest.raises(UsageError):
                third_party(home / "part.lib")
    if block == BLOCKS[0]:
        assert acted >= 3, "the oracle is blind"
