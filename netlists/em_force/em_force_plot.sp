*ng_script
* Run it with:  ngspice em_force_plot.sp
source em_force.cir
run
plot v(em_force_y) ylabel 'um' title 'em_force'
plot v(force0) v(force1) v(force2) v(force3) v(force4) v(force5) ylabel 'N' title 'em_force'
