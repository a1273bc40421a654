*ng_script
* Run it with:  ngspice buzzer_ft_35t_1_8a1_plot.sp
source buzzer_ft_35t_1_8a1.cir
run
plot db(v(disc_anode)) xlog ylabel 'dB of V' title 'buzzer_ft_35t_1_8a1'
plot db(i(vdrive)) xlog ylabel 'dB of A' title 'buzzer_ft_35t_1_8a1'
