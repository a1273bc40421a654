*ng_script
* Run it with:  ngspice imprint_plot.sp
source imprint.cir
run
plot v(imprint_bottom) v(kick_r0) v(kick_r1) v(kick_r2) v(kick_r3) v(kick_r4) ylabel 'um' title 'imprint'
plot v(kick_anode) ylabel 'V' title 'imprint'
plot @b.xcontact.br0[i] @b.xcontact.br1[i] @b.xcontact.br2[i] @b.xcontact.br3[i] @b.xcontact.br4[i] @b.xcontact.br5[i] ylabel 'N' title 'imprint'
