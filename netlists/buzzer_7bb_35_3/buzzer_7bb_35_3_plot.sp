*ng_script
* Run it with:  ngspice buzzer_7bb_35_3_plot.sp
source buzzer_7bb_35_3.cir
run
plot db(v(disc_anode)) xlog ylabel 'dB of V' title 'buzzer_7bb_35_3'
plot db(i(vdrive)) xlog ylabel 'dB of A' title 'buzzer_7bb_35_3'
