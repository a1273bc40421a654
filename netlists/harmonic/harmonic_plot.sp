*ng_script
* Run it with:  ngspice harmonic_plot.sp
source harmonic.cir
run
plot db(v(r0_r0)) db(v(r1_r0)) db(v(r2_r0)) db(v(r3_r0)) db(v(r4_r0)) db(v(r5_r0)) xlog ylabel 'dB of um' title 'harmonic'
plot db(v(charge_r0)) db(v(charge_r1)) db(v(charge_r2)) db(v(charge_r3)) db(v(charge_r4)) db(v(charge_r5)) xlog ylabel 'dB of C' title 'harmonic'
