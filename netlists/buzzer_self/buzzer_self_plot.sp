*ng_script
* Run it with:  ngspice buzzer_self_plot.sp
source buzzer_self.cir
run
plot v(disc_anode) v(disc_feedback) v(circuit_vcc) ylabel 'V' title 'buzzer_self'
plot v(disc_centre) ylabel 'um' title 'buzzer_self'
plot i(vbattery) ylabel 'A' title 'buzzer_self'
