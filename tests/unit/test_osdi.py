"""The testbench of compiled modules, line by line."""

from kc2spice.netlist.circuit import Pin, Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.osdi import testbench as bench_of

MAIN = """.save is the title, whatever it says
* Run it with:  ngspice -b -r one.raw one.cir
* and look at it with ngspice one_plot.sp
* a note
.include part.lib
.INC other.lib
.include plain.lib
.include extra.lib
Vin in 0 1

* before the part
Xpart in out Part r=2 c={3*k}
xQ out 0 params: OTHER
Xplain out 0 plain x=1
.save v(in) v(xpart.n) i(Vin) i(v.xpart.v1) @b.x1.b2[i]
.tran 1u 1m 0 2u UIC
.print tran v(in)
.end
"""

BENCH = """.save is the title, whatever it says
* Run it with:  openvaf-r part.va && openvaf-r others.va && ngspice -b -r one.raw one_osdi.cir
* Each part is a Verilog-A module, compiled by OpenVAF and loaded by ngspice 39 or later.
.control
pre_osdi part.osdi
pre_osdi others.osdi
.endc
.model mxpart Part r=2 c={3*k}
.model mxq OTHER
* a note
.include plain.lib
.include extra.lib
Vin in 0 1

* before the part
Npart in out mxpart
NQ out 0 mxq
Xplain out 0 plain x=1
.save v(in)
.save i(Vin)
.tran 1u 1m 0 2u
.end
"""


def test_modules_stand_where_their_subcircuits_stood():
    pins = (Pin("a", "V", "A"), Pin("b", "V", "A"))
    modules = (Subcircuit("part", pins, (), ""), Subcircuit("other", pins, (), "", "others.lib"))
    libraries = {"part.lib": "* part", "others.lib": "* other"}
    libraries |= (kept := {"extra.lib": "* extra", "plain.lib": "* plain"})
    main = MAIN.replace("other.lib", "others.lib")
    files = bench_of(Deck(name="one", text=main, more=libraries), modules)
    assert files == {"one_osdi.cir": BENCH, **kept}
