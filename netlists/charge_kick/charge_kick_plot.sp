*ng_script
* Run it with:  ngspice charge_kick_plot.sp
source charge_kick.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'charge_kick'
plot @r.xkick_driver.rout[i] v(xcatch.i) i(vkick_drive) i(vcontrol_enable) ylabel 'A' title 'charge_kick'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'charge_kick'
plot v(contact_v) ylabel 'm/s' title 'charge_kick'
plot v(kick_drive_out) v(kick_anode) v(kick_cathode) v(control_enable) ylabel 'V' title 'charge_kick'
