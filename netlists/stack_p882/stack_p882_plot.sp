*ng_script
* Run it with:  ngspice stack_p882_plot.sp
source stack_p882.cir
run
plot db(v(stack_anode)) xlog ylabel 'dB of V' title 'stack_p882'
plot db(i(vdrive)) xlog ylabel 'dB of A' title 'stack_p882'
