*ng_script
* Run it with:  ngspice impact_plot.sp
source impact.cir
run
plot v(kick_r0) v(kick_r1) v(sphere_y) ylabel 'um' title 'impact'
plot v(kick_anode) ylabel 'V' title 'impact'
plot @b.xcontact.br0[i] @b.xcontact.br1[i] ylabel 'N' title 'impact'
plot v(contact_v) ylabel 'm/s' title 'impact'
