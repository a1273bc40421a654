*ng_script
* Run it with:  ngspice newtons_cradle_plot.sp
source newtons_cradle.cir
run
plot v(sphere1_y) v(sphere2_y) v(sphere3_y) v(sphere4_y) v(sphere5_y) ylabel 'um' title 'newtons_cradle'
plot v(sphere1_v) v(sphere2_v) v(sphere3_v) v(sphere4_v) v(sphere5_v) ylabel 'm/s' title 'newtons_cradle'
plot @b.xcontact12.bbottom[i] @b.xcontact23.bbottom[i] @b.xcontact34.bbottom[i] @b.xcontact45.bbottom[i] ylabel 'N' title 'newtons_cradle'
