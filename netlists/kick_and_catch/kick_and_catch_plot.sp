*ng_script
* Run it with:  ngspice kick_and_catch_plot.sp
source kick_and_catch.cir
run
plot v(kick_ring0) v(kick_ring1) v(sphere_y) ylabel 'um' title 'kick_and_catch'
plot v(kick_anode) v(control_enable) ylabel 'V' title 'kick_and_catch'
plot i(vkick_drive) v(xcatch.i) i(vcontrol_enable) ylabel 'A' title 'kick_and_catch'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] ylabel 'N' title 'kick_and_catch'
plot v(contact_v) ylabel 'm/s' title 'kick_and_catch'
