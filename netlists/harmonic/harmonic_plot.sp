*ng_script
* Run it with:  ngspice harmonic_plot.sp
source harmonic.cir
run
plot db(v(ring0_ring0)) db(v(ring1_ring0)) db(v(ring2_ring0)) db(v(ring3_ring0)) db(v(ring4_ring0)) db(v(ring5_ring0)) xlog ylabel 'dB of um' title 'harmonic'
plot db(v(charge_ring0)) db(v(charge_ring1)) db(v(charge_ring2)) db(v(charge_ring3)) db(v(charge_ring4)) db(v(charge_ring5)) xlog ylabel 'dB of C' title 'harmonic'
