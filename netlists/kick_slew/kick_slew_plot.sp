*ng_script
* Run it with:  ngspice kick_slew_plot.sp
source kick_slew.cir
run
plot v(kick_ring0) v(kick_ring1) v(kick_ring2) v(sphere_y) ylabel 'um' title 'kick_slew'
plot v(kick_anode) ylabel 'V' title 'kick_slew'
plot i(vkick_drive) ylabel 'A' title 'kick_slew'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] @b.xcontact.bring2[i] ylabel 'N' title 'kick_slew'
plot v(contact_v) ylabel 'm/s' title 'kick_slew'
