*ng_script
* Run it with:  ngspice buzzer_ft_39t_2_5b1_plot.sp
source buzzer_ft_39t_2_5b1.cir
run
plot db(v(disc_anode)) xlog ylabel 'dB of V' title 'buzzer_ft_39t_2_5b1'
plot db(i(vdrive)) xlog ylabel 'dB of A' title 'buzzer_ft_39t_2_5b1'
