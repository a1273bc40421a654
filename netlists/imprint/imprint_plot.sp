*ng_script
* Run it with:  ngspice imprint_plot.sp
source imprint.cir
run
plot v(imprint_bottom) v(kick_ring0) v(kick_ring1) v(kick_ring2) v(kick_ring3) v(kick_ring4) ylabel 'um' title 'imprint'
plot v(kick_anode) ylabel 'V' title 'imprint'
plot @b.xcontact.bring0[i] @b.xcontact.bring1[i] @b.xcontact.bring2[i] @b.xcontact.bring3[i] @b.xcontact.bring4[i] @b.xcontact.bring5[i] ylabel 'N' title 'imprint'
