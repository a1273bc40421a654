"""Thirty op-amp and transistor models in the dialects of their vendors: scanned, linted, working.

All are written for this test from the syntax in ngspice's manual. Every op-amp follows its input,
every transistor switches, in ngspice, through the same gates as a user's own file.
"""

import pytest
from support import Deck, read_checked_circuit, require_valid_wiring, run_deck

# Pins: inp inn vcc vee out.
OPAMPS = {
    "one pole": "Gm 0 x inp inn 1\nRx x 0 1e5\nCx x 0 16u\nEo out 0 x 0 1\n",
    "upper case": "GM 0 X INP INN 1\nRX X 0 100K\nCX X 0 16U\nEO OUT 0 X 0 1\n",
    "continued cards": "Gm 0 x\n+ inp\n+inn 1\nRx x 0 1e5\n* in between\nCx x 0 16u\nEo out 0\n"
    "+ x 0 1\n",
    "two poles": "G1 0 x inp inn 1m\nR1 x 0 1Meg\nC1 x 0 1n\nG2 0 y x 0 1m\nR2 y 0 10k\n"
    "C2 y 0 1p\nEo out 0 y 0 1\n",
    "poly sources": "Ed d 0 POLY(2) inp 0 inn 0 0 1 -1\nG1 0 x d 0 1\nRx x 0 1e5\nCx x 0 1u\n"
    "Eo out 0 POLY(1) x 0 0 1\n",
    "value sources": "E1 x 0 VALUE={1e5*(V(inp)-V(inn))}\nR1 x y 1k\nC1 y 0 1n\n"
    "E2 out 0 VALUE = {max(V(vee),min(V(vcc),V(y)))}\n",
    "table source": "E1 x 0 TABLE {V(inp)-V(inn)} = (-1m,-10) (1m,10)\nR1 x out 100\nC1 out 0 1n\n",
    "tanh": "B1 x 0 V=10*tanh(1e4*(V(inp)-V(inn)))\nR1 x out 100\nC1 out 0 1n\n",
    "offset and bias": "Vos p inp 100u\nIb1 inp 0 10n\nIb2 inn 0 10n\nRin p inn 2Meg\n"
    "G1 0 x p inn 1\nRx x 0 1e5\nCx x 0 1u\nEo y 0 x 0 1\nRo y out 50\n",
    "diode clamps": "G1 0 x inp inn 10m\nRx x 0 10Meg\nCx x 0 30p\nD1 x c1 DC\nVc1 vcc c1 1\n"
    "D2 c2 x DC\nVc2 c2 vee 1\nEo y 0 x 0 1\nRo y out 75\n.model DC D(IS=8e-16 RS=1)\n",
    "bipolar pair": "Q1 c1 inn e QX\nQ2 c2 inp e QX\nRc1 vcc c1 2k\nRc2 vcc c2 2k\nIee e vee 1m\n"
    "Rs vcc 0 1e6\nG1 0 x c1 c2 0.1\nRx x 0 1e5\nCx x 0 100n\nEo out 0 x 0 1\n"
    ".model QX NPN(BF=200)\n",
    "junction pair": "J1 c1 inn e JX\nJ2 c2 inp e JX\nRd1 vcc c1 5k\nRd2 vcc c2 5k\n"
    "Iss e vee 0.5m\n"
    "G1 0 x c1 c2 1\nRx x 0 1e6\nCx x 0 1u\nEo out 0 x 0 1\n"
    ".model JX NJF(VTO=-1 BETA=1m LAMBDA=1m)\n",
    "parameters": ".param gain={10*1k*10} pole=10\nG1 0 x inp inn 1\nRx x 0 {gain}\n"
    "Cx x 0 {1/(6.2831853*gain*pole)}\nEo out 0 x 0 1\n",
    "function": ".func clip(x) {max(-10,min(10,x))}\nB1 x 0 V={clip(1e5*(V(inp)-V(inn)))}\n"
    "R1 x out 10\nC1 out 0 1u\n",
    "nested stages": "X1 inp inn s stage\nX2 s 0 out buffer\n.subckt stage a b o\nG1 0 o a b 1\n"
    "R1 o 0 1e5\nC1 o 0 1u\n.ends stage\n.subckt buffer a b o\nE1 o b a b 1\n.ends\n",
}  # fmt: skip
# Pins: out (collector, drain), in (base, gate), ref; with the drive that turns it on, polarity.
TRANSISTORS = {
    "NPN": (1, "Q1 out in ref QN\n.model QN NPN(IS=1e-14 BF=300 VAF=100 IKF=0.4 ISE=3e-15 NE=1.5\n"
            "+ RB=10 RC=0.3 CJE=2e-11 CJC=8e-12 TF=4e-10 TR=5e-8)\n"),
    "PNP": (-1, "Q1 out in ref QP\n.model QP PNP(IS=1e-14 BF=200 VAF=60 TF=6e-10)\n"),
    "power NPN with area": (1, "Q1 out in ref QN 10\n.model QN NPN IS=1e-13 BF=80 XTB=1.5\n"),
    "Darlington": (1, "Q1 out in m QN\nQ2 out m ref QN 4\nR1 in m 10k\nR2 m ref 150\n"
                   "D1 ref out DX\n"
                   ".model QN NPN(BF=100)\n.model DX D(IS=1e-12 BV=100)\n"),
    "NJF": (1, "J1 out in ref JN\n.model JN NJF(VTO=-2 BETA=2m LAMBDA=1e-3)\n"),
    "PJF": (-1, "J1 out in ref JP\n.model JP PJF VTO=-2 BETA=2m\n"),
    "NMOS level 1": (1, "M1 out in ref ref MN L=1u W=100u\n"
                     ".model MN NMOS(LEVEL=1 VTO=1 KP=100u LAMBDA=0.01 CGSO=1n)\n"),
    "PMOS level 1": (-1, "M1 out in ref ref MP L=1u W=200u\n.model MP PMOS(VTO=-1 KP=40u)\n"),
    "NMOS level 2": (1, "M1 out in ref ref MN L=2u W=100u\n"
                     ".model MN NMOS(LEVEL=2 VTO=1 UO=600 TOX=5e-8 NSUB=1e15)\n"),
    "NMOS level 3": (1, "M1 out in ref ref MN L=2u W=100u\n"
                     ".model MN NMOS(LEVEL=3 VTO=1 UO=600 TOX=4e-8 NSUB=1e15 THETA=0.1)\n"),
    "BSIM3": (1, "M1 out in ref ref MN L=0.5u W=50u\n.model MN NMOS(LEVEL=8 VERSION=3.3.0)\n"),
    "BSIM4": (1, "M1 out in ref ref MN L=0.2u W=50u\n.model MN NMOS(LEVEL=14 VERSION=4.8.0)\n"),
    "VDMOS": (1, "M1 out in ref MV\n.model MV VDMOS(VTO=2 KP=10 RD=0.05 RS=0.01 RG=3 CGS=1n\n"
              "+ CGDMAX=0.8n CGDMIN=0.05n IS=1e-12 CJO=0.4n)\n"),
    "power MOSFET of parts": (1, "M1 d g s s MN W=1 L=2u\nRg in g 5\nRd out d {rd}\nLs s ref 7n\n"
                              "Cgd g d 50p\nD1 s d DB\n.param rd=0.1\n"
                              ".model MN NMOS(VTO=2 KP=20u)\n"
                              ".model DB D(IS=1e-12 RS=0.01 BV=60 TT=50n)\n"),
    "MESFET": (1, "Z1 out in ref ZN\n.model ZN NMF(VTO=-1.5 BETA=5m ALPHA=2)\n"),
    "IGBT of parts": (1, "M1 b in ref ref MN W=1m L=1u\nQ1 ref b out QP\n"
                      ".model MN NMOS(VTO=2 KP=100u)\n.model QP PNP(BF=5 IS=1e-14)\n"),
}  # fmt: skip


def through(text, pins, bench, vectors, tmp_path):
    """One operating point of ``bench`` with the user's file, past scan and lint."""
    (tmp_path / "user.lib").write_text(f"* a user's part\n.subckt part {pins}\n{text}.ends part\n")
    main = f"* bench\n{bench}.include user.lib\n.dc Vin {{0}} {{1}} {{2}}\n"
    for vector, _ in vectors.values():
        main += f".save {vector}\n"
    files = {"user.lib": read_checked_circuit(tmp_path / "user.lib").text}

    def sweep(first, last, step):
        cards = main.replace("{0} {1} {2}", f"{first} {last} {step}") + ".end\n"
        deck = Deck(name="t", text=cards, more=files, vectors=vectors)
        require_valid_wiring(deck)
        return run_deck(deck, tmp_path / "run", timeout=20)

    return sweep


@pytest.mark.parametrize("text", OPAMPS.values(), ids=OPAMPS)
def test_op_amps_follow_their_input(text, tmp_path):
    bench = "Vp vcc 0 12\nVm vee 0 -12\nVin in 0 0\nRin in inp 1k\nRl out 0 10k\n"
    bench += "Rs vcc vee 1e6\nX1 inp out vcc vee out part\n"
    sweep = through(text, "inp inn vcc vee out", bench, {"out": ("v(out)", 1.0)}, tmp_path)
    waves = sweep(-1, 1, 0.5)
    assert waves["out"] == pytest.approx(waves["sweep"], abs=0.02)


OFF_AND_ON = {"NJF": (-5, 0), "PJF": (5, 0), "MESFET": (-5, 0)}  # V; all others (0, 5)


@pytest.mark.parametrize("name", TRANSISTORS)
def test_transistors_switch(name, tmp_path):
    polarity, text = TRANSISTORS[name]
    first, last = OFF_AND_ON.get(name, (0, 5 * polarity))
    bench = f"Vs vdd 0 {10 * polarity}\nRl vdd out 10k\nVin in 0 0\nRin in b 10k\nX1 out b 0 part\n"
    sweep = through(text, "out in ref", bench, {"out": ("v(out)", 1.0)}, tmp_path)
    off, on = polarity * sweep(first, last, last - first)["out"]
    assert off > 9
    assert on < 3
