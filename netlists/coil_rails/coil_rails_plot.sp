*ng_script
* Run it with:  ngspice coil_rails_plot.sp
source coil_rails.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'coil_rails'
plot v(kick_anode) v(control_command) v(catch_up) v(catch_lp) v(control_enable) ylabel 'V' title 'coil_rails'
plot i(vkick_drive) v(xcatch.i1) v(xcatch.i2) @r.xcatch_driver.rout[i] i(vcontrol_enable) ylabel 'A' title 'coil_rails'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'coil_rails'
plot v(contact_v) ylabel 'm/s' title 'coil_rails'
