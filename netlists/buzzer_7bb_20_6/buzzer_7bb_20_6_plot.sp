*ng_script
* Run it with:  ngspice buzzer_7bb_20_6_plot.sp
source buzzer_7bb_20_6.cir
run
plot db(v(disc_anode)) xlog ylabel 'dB of V' title 'buzzer_7bb_20_6'
plot db(i(vdrive)) xlog ylabel 'dB of A' title 'buzzer_7bb_20_6'
