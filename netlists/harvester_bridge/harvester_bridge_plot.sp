*ng_script
* Run it with:  ngspice harvester_bridge_plot.sp
source harvester_bridge.cir
run
plot v(beam_tip) ylabel 'um' title 'harvester_bridge'
plot v(beam_base) ylabel 'm/s2' title 'harvester_bridge'
plot i(vshaker) ylabel 'N' title 'harvester_bridge'
plot @d.xd1.djunction[id] @d.xd2.djunction[id] @d.xd3.djunction[id] @d.xd4.djunction[id] i(vstore_meter) ylabel 'A' title 'harvester_bridge'
plot v(d1_cathode) ylabel 'V' title 'harvester_bridge'
