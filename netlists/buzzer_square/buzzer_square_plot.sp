*ng_script
* Run it with:  ngspice buzzer_square_plot.sp
source buzzer_square.cir
run
plot v(disc_anode) v(series_a) ylabel 'V' title 'buzzer_square'
plot v(disc_centre) ylabel 'um' title 'buzzer_square'
plot i(vgate) ylabel 'A' title 'buzzer_square'
