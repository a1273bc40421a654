*ng_script
* Run it with:  ngspice buzzer_ft_27t_4_3a1_plot.sp
source buzzer_ft_27t_4_3a1.cir
run
plot db(v(disc_anode)) xlog ylabel 'dB of V' title 'buzzer_ft_27t_4_3a1'
plot db(i(vdrive)) xlog ylabel 'dB of A' title 'buzzer_ft_27t_4_3a1'
