*ng_script
* Run it with:  ngspice kick_slew_plot.sp
source kick_slew.cir
run
plot v(kick_r0) v(kick_r1) v(kick_r2) v(sphere_y) ylabel 'um' title 'kick_slew'
plot v(kick_anode) ylabel 'V' title 'kick_slew'
plot i(vkick_drive) ylabel 'A' title 'kick_slew'
plot @b.xcontact.br0[i] @b.xcontact.br1[i] @b.xcontact.br2[i] ylabel 'N' title 'kick_slew'
plot v(contact_v) ylabel 'm/s' title 'kick_slew'
