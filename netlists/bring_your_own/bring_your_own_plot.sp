*ng_script
* Run it with:  ngspice bring_your_own_plot.sp
source bring_your_own.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'bring_your_own'
plot v(kick_anode) v(kick_drive_out) v(control_enable) ylabel 'V' title 'bring_your_own'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'bring_your_own'
plot v(contact_v) ylabel 'm/s' title 'bring_your_own'
plot v(xcatch.i) i(vkick_drive) i(vcontrol_enable) ylabel 'A' title 'bring_your_own'
