*ng_script
* Run it with:  ngspice three_cycles_plot.sp
source three_cycles.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'three_cycles'
plot v(kick_anode) v(control_enable) ylabel 'V' title 'three_cycles'
plot i(vkick_drive) v(xcatch.i) i(vcontrol_enable) ylabel 'A' title 'three_cycles'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'three_cycles'
plot v(contact_v) ylabel 'm/s' title 'three_cycles'
