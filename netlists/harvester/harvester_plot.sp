*ng_script
* Run it with:  ngspice harvester_plot.sp
source harvester.cir
run
plot db(v(beam_anode)) xlog ylabel 'dB of V' title 'harvester'
plot db(v(beam_tip)) xlog ylabel 'dB of um' title 'harvester'
plot db(v(beam_base)) xlog ylabel 'dB of m/s2' title 'harvester'
plot db(i(vshaker)) xlog ylabel 'dB of N' title 'harvester'
