*ng_script
* Run it with:  ngspice impact_plot.sp
source impact.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'impact'
plot v(kick_anode) ylabel 'V' title 'impact'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'impact'
plot v(contact_v) ylabel 'm/s' title 'impact'
