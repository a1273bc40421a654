*ng_script
* Run it with:  ngspice pwm_coil_plot.sp
source pwm_coil.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'pwm_coil'
plot v(kick_anode) v(control_command) v(catch_up) v(catch_lp) v(control_enable) ylabel 'V' title 'pwm_coil'
plot i(vkick_drive) v(xcatch.i1) v(xcatch.i2) @r.xcatch_driver.rout[i] i(vcontrol_enable) ylabel 'A' title 'pwm_coil'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'pwm_coil'
plot v(contact_v) ylabel 'm/s' title 'pwm_coil'
